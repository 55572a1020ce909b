"""`scripts/faults resumes`: kills training runs, resumes them, and compares them with the run that nobody killed."""

import argparse
import importlib
import json
import random
import signal
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from statistics import median
from typing import Any

from benchmarks import figures
from benchmarks.child import BenchError
from benchmarks.log_faults.resume import LONGEST_EXIT_S, MOMENTS, Resume, kill_and_resume, run_to_the_end
from benchmarks.log_faults.training import preload
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, positive, tell, writable

HEADER = (
    "signal",
    "moment",
    "runs",
    "resumed from a checkpoint",
    "from the one before",
    "begun anew",
    "faults",
    "exit s: median",
    "max",
)
SIGNALS = (signal.SIGTERM, signal.SIGKILL)
NOTES = (
    "from the one before: the kill came between two renamings.",
    "begun anew: there was no checkpoint yet; with the same command where there was no configuration either.",
    f"exit s: from SIGTERM, a second kill's too, to the end of the process; more than {LONGEST_EXIT_S:g} s is a fault.",
    "Each run is compared, bit for bit but for wall time, with the one that nobody killed: the final parameters and",
    "all else in state.pt, best.pt, last.pt, the tables, the log's transitions and episodes, the summary, the names of",
    "all files but Hydra's records of itself.",
)
Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def main(argv: list[str] | None = None) -> int:
    """Kills, resumes and prints; returns 0, or 1 where anything was not as it should be."""
    arguments = _parse(argv)
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    machine = describe_machine()
    print(machine_line(machine) + "\n")
    resumes: list[Resume] = []
    try:
        _kill_runs(arguments, resumes)
        code = int(any(resume.faults for resume in resumes))
    except BenchError as error:
        print(f"scripts/faults resumes: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        code = 130
    print_results(resumes, table)
    if arguments.json:
        result: dict[str, Any] = {"machine": machine, "resumes": [asdict(resume) for resume in resumes]}
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return code


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/faults resumes", description=__doc__)
    parser.add_argument("--kills", type=positive(int), default=100, metavar="N", help="runs to kill")
    parser.add_argument("--experiment", default="fast", metavar="NAME", help="what they train, of one replicate")
    parser.add_argument("--interval", type=positive(float), default=0.3, metavar="S", help="between two checkpoints, s")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the moments at which they are killed")
    parser.add_argument("--markdown", action="store_true", help="print tables for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep the figures of every kill")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="more Hydra overrides of the runs")
    return parser.parse_args(argv)


def _kill_runs(arguments: argparse.Namespace, resumes: list[Resume]) -> None:
    """Adds the kills one by one."""
    preload()
    for name in ("carrl.sim.kernels", "matplotlib.pyplot"):
        importlib.import_module(name)
    interval = f"trainer.checkpoint_interval={arguments.interval}"
    reference = run_to_the_end([f"experiment={arguments.experiment}", interval, *arguments.overrides])
    transitions, states = len(reference.contents.log.rows), reference.places["renaming"] // 2 + 1
    tell(f"the run that nobody kills: {transitions:,} transitions in {reference.seconds:.1f} s, {states} states")
    draw = random.Random(arguments.seed)
    for number in range(arguments.kills):
        resumes.append(kill_and_resume(reference, SIGNALS[number % 2], draw))
        tell(f"kill {number + 1} of {arguments.kills}: {_describe(resumes[-1])}")


def _describe(resume: Resume) -> str:
    became = f"FAULT: {'; '.join(resume.faults)}" if resume.faults else "the same run"
    return f"{resume.signal} {resume.moment}, {resume.kills} signals, {resume.found} left: {became}"


def print_results(resumes: Sequence[Resume], table: Table) -> None:
    """Prints what became of the runs, by signal and moment."""
    groups = [(number.name, moment) for number in SIGNALS for moment in MOMENTS]
    rows = [_row(*group, [r for r in resumes if (r.signal, r.moment) == group]) for group in groups]
    print(table(HEADER, [*rows, _row("all", "", resumes)]) + "\n")
    print("\n".join(NOTES))
    late = sum(resume.ended_before for resume in resumes)
    again, faultless = sum(r.kills > 1 for r in resumes), sum(not r.faults for r in resumes)
    print(f"{late} others, not counted, had ended before the signal came.")
    print(f"{again} were killed once more after they had been resumed, and resumed again.")
    print(f"{faultless} of {len(resumes)} ended as the run that nobody killed.")
    for number, resume in enumerate(resumes, start=1):
        for fault in resume.faults:
            print(f"FAULT in kill {number}, {resume.signal} {resume.moment}: {fault}")


def _row(name: str, moment: str, resumes: Sequence[Resume]) -> list[str]:
    found = Counter(resume.found for resume in resumes)
    exits = [seconds for resume in resumes for seconds in resume.exit_s]
    return [
        name,
        moment,
        str(len(resumes)),
        str(found["checkpoint"] + found["checkpoint before"]),
        str(found["checkpoint before"]),
        str(found["configuration"] + found["nothing"]),
        str(sum(bool(resume.faults) for resume in resumes)),
        f"{median(exits):.2f}" if exits else "-",
        f"{max(exits):.2f}" if exits else "-",
    ]


if __name__ == "__main__":
    sys.exit(main())
