"""`scripts/faults mutations`: damages a log in thousands of ways and checks what is recovered and what is read."""

import argparse
import json
import random
import resource
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import figures
from benchmarks.child import BenchError
from benchmarks.log_faults.check import Outcome, check
from benchmarks.log_faults.damage import DAMAGES, SEVERAL, damage
from benchmarks.log_faults.sample import Sample, train_sample
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, positive, tell, writable

FRAMES = (1504, 1208)
"""Env steps of the run whose log is damaged, and of the one whose log is mixed up with it."""
HEADER = ("damage", "files", "nothing left", "transitions kept: median", "least", "metadata lost", "faults")
NOTES = (
    "nothing left: not one intact record, and not even the mark that a log begins with; recovery says so.",
    "transitions kept: in % of those of the run recovered, which is the one that the file has most transitions of.",
    "Whatever is in a chunk whose bytes are all there was recovered, unless it is counted as a fault.",
)
Outcomes = list[tuple[str, Outcome]]
"""What was done to each file, and what became of it."""
Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def main(argv: list[str] | None = None) -> int:
    """Damages, checks and prints; returns 0, or 1 where anything was not as it should be."""
    arguments = _parse(argv)
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    machine = describe_machine()
    print(machine_line(machine) + "\n")
    outcomes: Outcomes = []
    try:
        tell("training the runs whose logs are damaged")
        own, other = (train_sample(arguments.experiment, seed, frames) for seed, frames in enumerate(FRAMES))
        size, pieces = len(own.content), len(own.pieces)
        print(f"A log of {len(own.says.rows):,} transitions, {size:,} bytes, {pieces} records to recover.\n")
        before = _peak_memory()
        _damage_files(arguments, own, other, outcomes)
        code = int(any(outcome.faults for _, outcome in outcomes))
    except BenchError as error:
        print(f"scripts/faults mutations: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print_results(outcomes, table)
    print(f"Peak memory: {_peak_memory():.0f} MiB, of which {before:.0f} before the first file.")
    if arguments.json:
        result: dict[str, Any] = {"machine": machine, "files": [{"damage": d, **asdict(o)} for d, o in outcomes]}
        arguments.json.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return code


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/faults mutations", description=__doc__)
    parser.add_argument("--mutations", type=positive(int), default=10_000, metavar="N", help="files to damage")
    parser.add_argument("--experiment", default="fast", metavar="NAME", help="what the logs are of, of one replicate")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the damages")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the files in which there is a fault")
    parser.add_argument("--markdown", action="store_true", help="print tables for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep the figures of every file")
    return parser.parse_args(argv)


def _damage_files(arguments: argparse.Namespace, own: Sample, other: Sample, outcomes: Outcomes) -> None:
    """Adds the outcomes one by one."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(arguments.mutations):
            name, damaged = damage(random.Random(f"{arguments.seed}:{number}"), own, other)
            outcome = check(damaged, (own, other), Path(folder))
            outcomes.append((name, outcome))
            if outcome.faults and arguments.keep:
                arguments.keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(Path(folder) / "damaged.mcap", arguments.keep / f"damaged-{number}.mcap")
                (arguments.keep / "own.mcap").write_bytes(own.content)
                (arguments.keep / "other.mcap").write_bytes(other.content)
            if (number + 1) % 1000 == 0:
                tell(f"{number + 1:,} of {arguments.mutations:,} files")


def _peak_memory() -> float:
    """Of this process so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def print_results(outcomes: Outcomes, table: Table) -> None:
    """Prints a row for each kind of damage, and every fault."""
    rows = [_row(name, [o for each, o in outcomes if name in (each, "all")]) for name in (*DAMAGES, SEVERAL, "all")]
    print(table(HEADER, rows) + "\n")
    print("\n".join(NOTES))
    unchanged = sum(not outcome.noticed and not outcome.spared for _, outcome in outcomes)
    spared = sum(outcome.spared for _, outcome in outcomes)
    print(f"Verification refused all but {unchanged} files in which not a byte had changed, and {spared} others.")
    seconds = [1e3 * outcome.recovery_s for _, outcome in outcomes]
    print(f"Recovery took {median(seconds):.0f} ms of processor time (median), at most {max(seconds):.0f} ms.")
    for number, (name, outcome) in enumerate(outcomes):
        for fault in outcome.faults:
            print(f"FAULT in file {number}, {name}: {fault}")


def _row(name: str, outcomes: Sequence[Outcome]) -> list[str]:
    kept = [100 * outcome.kept for outcome in outcomes if outcome.kept is not None]
    return [
        name,
        f"{len(outcomes):,}",
        str(len(outcomes) - len(kept)),
        f"{median(kept):.0f}" if kept else "-",
        f"{min(kept):.0f}" if kept else "-",
        f"{sum(outcome.metadata_lost for outcome in outcomes):,}",
        str(sum(bool(outcome.faults) for outcome in outcomes)),
    ]


if __name__ == "__main__":
    sys.exit(main())
