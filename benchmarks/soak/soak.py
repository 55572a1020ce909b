"""`scripts/soak`: one long run of the default training, with its memory and open files watched from outside."""

import argparse
import json
import sys
from dataclasses import asdict

from benchmarks import figures
from benchmarks.child import BenchError
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, positive, tell, writable
from benchmarks.soak.process import Sample, watch
from benchmarks.soak.verdict import HEADER, MOST_GROWTH, PARTS, SETTLED, growth, parts, row

MOST_EPISODES = 10_000_000
_TOLD_EVERY = 30
NOTES = (
    "RSS: what of the process's memory is in RAM. Handles: open files, sockets and the like.",
    f"Since {SETTLED} of {PARTS} parts are over, no later part's median may be more than {MOST_GROWTH:.0%} above the",
    "first one's for memory, nor above it at all for handles.",
)


def main(argv: list[str] | None = None) -> int:
    """Trains, watches and prints; returns 0, or 1 where anything grows."""
    arguments = _parse(argv)
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    machine = describe_machine()
    print(machine_line(machine) + "\n")
    samples: list[Sample] = []
    try:
        _watch(arguments, samples)
    except BenchError as error:
        print(f"scripts/soak: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    in_parts = parts(samples, arguments.frames)
    ends_s = [0.0, *(part[-1].seconds if part else 0.0 for part in in_parts)]
    print(table(HEADER, [row(n, part, arguments.frames, ends_s[n]) for n, part in enumerate(in_parts)]) + "\n")
    print("\n".join(NOTES))
    faults = list(growth(in_parts))
    print("\n".join(f"FAULT: {fault}" for fault in faults) or "Nothing grows.")
    if arguments.json:
        result = {"machine": machine, "samples": [asdict(sample) for sample in samples]}
        arguments.json.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return int(bool(faults))


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/soak", description=__doc__)
    parser.add_argument("--frames", type=positive(int), default=1_000_000, metavar="N", help="env steps of the run")
    parser.add_argument("--markdown", action="store_true", help="print the table for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep every look at the process")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="more Hydra overrides of the run")
    return parser.parse_args(argv)


def _watch(arguments: argparse.Namespace, samples: list[Sample]) -> None:
    """Adds the looks one by one."""
    limits = [f"trainer.frames={arguments.frames}", f"trainer.episodes={MOST_EPISODES}"]
    for sample in watch([*limits, *arguments.overrides]):
        samples.append(sample)
        if len(samples) % _TOLD_EVERY == 0:
            tell(f"{sample.frames:,} frames, {sample.memory_mib:.0f} MiB, {sample.handles} handles")


if __name__ == "__main__":
    sys.exit(main())
