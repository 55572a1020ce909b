"""`scripts/faults kills`: kills training runs with kill -9 and checks what is recovered of their logs."""

import argparse
import json
import random
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from statistics import median
from typing import Any

from benchmarks import figures
from benchmarks.child import BenchError
from benchmarks.log_faults.kill import ANY_MOMENT, BEGINNING, CLOSING, MOMENTS, RUNNING, Kill, kill_one, run_to_the_end
from benchmarks.log_faults.training import preload
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, positive, tell, writable

HEADER = ("killed", "runs", "no log yet", "unfinished", "finished", "faults")
LOSS_HEADER = ("lost while training", "number: median", "max", "seconds before the kill: median", "max")
_WEIGHTS = {ANY_MOMENT: 12, BEGINNING: 2, RUNNING: 4, CLOSING: 2}
NOTES = (
    "no log yet: the run was killed before the first byte of its log.",
    "lost while training: of unfinished logs of runs that had made a step.",
    "seconds before the kill: the age of the oldest one lost; 0 if none is.",
    "Each recovered log is compared, bit for bit, with that of the same seed's run that was not killed.",
)
Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def main(argv: list[str] | None = None) -> int:
    """Kills, recovers and prints; returns 0, or 1 where anything was not as it should be."""
    arguments = _parse(argv)
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    machine = describe_machine()
    print(machine_line(machine) + "\n")
    kills: list[Kill] = []
    waits_s: list[float] = []
    try:
        _kill_runs(arguments, kills, waits_s)
        code = int(any(kill.faults for kill in kills))
    except BenchError as error:
        print(f"scripts/faults kills: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        code = 130
    print_results(kills, table)
    print(f"No transition of a run that nobody killed waited longer than {max(waits_s, default=0):.2f} s for the disk.")
    if arguments.json:
        result: dict[str, Any] = {"machine": machine, "waits_s": waits_s, "kills": [asdict(kill) for kill in kills]}
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return code


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/faults kills", description=__doc__)
    parser.add_argument("--kills", type=positive(int), default=200, metavar="N", help="runs to kill")
    parser.add_argument("--experiment", default="fast", metavar="NAME", help="what they train, of one replicate")
    parser.add_argument("--run-seeds", type=positive(int), default=4, metavar="N", help="seeds that the runs have")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the moments at which they are killed")
    parser.add_argument("--markdown", action="store_true", help="print tables for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep the figures of every kill")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="more Hydra overrides of the runs")
    return parser.parse_args(argv)


def _kill_runs(arguments: argparse.Namespace, kills: list[Kill], waits_s: list[float]) -> None:
    """Adds the kills one by one, and before, for each seed, the longest wait of a transition."""
    preload()
    references = []
    for seed in range(min(arguments.run_seeds, arguments.kills)):
        references.append(run_to_the_end([f"experiment={arguments.experiment}", f"seed={seed}", *arguments.overrides]))
        waits_s.append(references[-1].longest_wait_s)
        tell(f"seed {seed}: {len(references[-1].contents.rows):,} transitions in {references[-1].seconds:.1f} s")
    seconds = min(reference.seconds for reference in references)
    references = [replace(reference, seconds=seconds) for reference in references]
    draw = random.Random(arguments.seed)
    for number in range(arguments.kills):
        [moment] = draw.choices(MOMENTS, [_WEIGHTS[moment] for moment in MOMENTS])
        kills.append(kill_one(references[number % len(references)], moment, draw))
        tell(f"kill {number + 1} of {arguments.kills}: {_describe(kills[-1])}")


def _describe(kill: Kill) -> str:
    if kill.faults:
        return f"{kill.moment}: FAULT: {'; '.join(kill.faults)}"
    lost = f", {kill.lost['transitions']} transitions lost" if kill.lost else ""
    return f"{kill.moment}: log {kill.state}{lost}"


def print_results(kills: Sequence[Kill], table: Table) -> None:
    """Prints how the logs were found, and what was lost of those that were being written."""
    print(table(HEADER, [_moment_row(moment, [k for k in kills if k.moment == moment]) for moment in MOMENTS]) + "\n")
    training = [kill for kill in kills if kill.state == "unfinished" and kill.transitions and kill.lost]
    if training:
        print(table(LOSS_HEADER, [_loss_row(kind, training) for kind in ("transitions", "episodes", "metrics")]))
        print(f"\nOf {len(training)} logs. Recovery took at most {max(kill.recovery_s for kill in kills):.2f} s.")
    print("\n".join(NOTES))
    for number, kill in enumerate(kills, start=1):
        for fault in kill.faults:
            print(f"FAULT in kill {number}, {kill.moment}: {fault}")


def _moment_row(moment: str, kills: Sequence[Kill]) -> list[str]:
    states = Counter(kill.state for kill in kills)
    counts = [len(kills), *(states[state] for state in ("none", "unfinished", "finished"))]
    return [moment, *map(str, counts), str(sum(bool(kill.faults) for kill in kills))]


def _loss_row(kind: str, kills: Sequence[Kill]) -> list[str]:
    numbers, seconds = [kill.lost[kind] for kill in kills], [kill.lost_s[kind] for kill in kills]
    return [kind, f"{median(numbers):g}", f"{max(numbers)}", f"{median(seconds):.2f}", f"{max(seconds):.2f}"]


if __name__ == "__main__":
    sys.exit(main())
