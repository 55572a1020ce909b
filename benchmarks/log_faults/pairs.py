"""`scripts/faults pairs`: starts two commands at once that want the same folder or file, and checks what is lost."""

import argparse
import importlib
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import figures
from benchmarks.child import BenchError
from benchmarks.log_faults.pair import KINDS, Pair, make_references, run_pair
from benchmarks.log_faults.training import preload
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, positive, tell, writable

HEADER = (
    "pair of",
    "pairs",
    "one success and one sentence, nothing lost",
    "refused: in use",
    "there already",
    "faults",
)
OVERRIDES = ("compile=false", "track=oval", "env.num_envs=8", "replay_buffer.batch_size=65536")
"""Of short runs that learn nothing, so that many can be made."""
IN_USE = "is in use by"
NOTES = (
    "Each two begin at the same moment: runs with different seeds into one folder, resumes of one run, the same sweep",
    "of two jobs twice, recoveries of one log into one file. One must succeed with exit code 0; the other must print",
    "one sentence and nothing else, with exit code 2. What the first leaves is compared, bit for bit but for wall",
    "time, with what the same command leaves alone.",
)


def main(argv: list[str] | None = None) -> int:
    """Starts pairs and prints; returns 0, or 1 where anything was not as it should be."""
    arguments = _parse(argv)
    machine = describe_machine()
    print(machine_line(machine) + "\n")
    pairs: list[Pair] = []
    try:
        _run_pairs(arguments, pairs)
        code = int(any(pair.faults for pair in pairs))
    except BenchError as error:
        print(f"scripts/faults pairs: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        code = 130
    print_results(pairs, arguments.markdown)
    if arguments.json:
        result: dict[str, Any] = {"machine": machine, "pairs": [asdict(pair) for pair in pairs]}
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return code


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/faults pairs", description=__doc__)
    parser.add_argument("--pairs", type=positive(int), default=100, metavar="N", help="how many, of all kinds in turn")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, help="of what (default: all)")
    parser.add_argument("--frames", type=positive(int), default=4000, metavar="N", help="env steps of a run")
    parser.add_argument("--markdown", action="store_true", help="print tables for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep what became of every pair")
    return parser.parse_args(argv)


def _run_pairs(arguments: argparse.Namespace, pairs: list[Pair]) -> None:
    """Adds the pairs one by one."""
    preload()
    for name in ("carrl.cli.log", "carrl.train.experiment", "carrl.sim.kernels", "matplotlib.pyplot"):
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as folder:
        references = make_references(Path(folder), OVERRIDES, arguments.frames)
        for number in range(arguments.pairs):
            pairs.append(run_pair(arguments.kinds[number % len(arguments.kinds)], references))
            tell(f"pair {number + 1} of {arguments.pairs}: {_describe(pairs[-1])}")


def _describe(pair: Pair) -> str:
    return f"{pair.kind}: {'FAULT: ' + '; '.join(pair.faults) if pair.faults else pair.sentence}"


def print_results(pairs: Sequence[Pair], markdown: bool = False) -> None:
    """Prints what became of the pairs, by kind."""
    table = figures.markdown_table if markdown else figures.plain_table
    rows = [_row(kind, [pair for pair in pairs if pair.kind == kind]) for kind in KINDS]
    print(table(HEADER, [*rows, _row("all", pairs)]) + "\n")
    print("\n".join(NOTES))
    print(f"{sum(not pair.faults for pair in pairs)} of {len(pairs)} lost nothing, with one success and one sentence.")
    for number, pair in enumerate(pairs, start=1):
        for fault in pair.faults:
            print(f"FAULT in pair {number}, {pair.kind}: {fault}")


def _row(name: str, pairs: Sequence[Pair]) -> list[str]:
    faultless = [pair for pair in pairs if not pair.faults]
    in_use = sum(IN_USE in pair.sentence for pair in faultless)
    counts = (len(pairs), len(faultless), in_use, len(faultless) - in_use, len(pairs) - len(faultless))
    return [name, *map(str, counts)]


if __name__ == "__main__":
    sys.exit(main())
