"""`scripts/fuzz`: feeds parsers with hostile files; whatever comes out of them but CarrlError is a fault."""

import argparse
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks import figures
from benchmarks.fuzz.logs import LogFile
from benchmarks.fuzz.maps import TrackMap, TrackRaceline
from benchmarks.fuzz.parser import Parser, judge, peak_mib
from benchmarks.fuzz.runs import Checkpoint, Results, RunConfig
from benchmarks.fuzz.tracks import TrackCsv, TrackDrawing, TrackGeoJson, TrackOpenDrive, TrackTorcs, TrackWaypoints
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser as ArgumentParser
from benchmarks.options import positive, tell

PARSERS: Mapping[str, type[Parser]] = {
    "track-csv": TrackCsv,
    "track-yaml": TrackDrawing,
    "track-npy": TrackWaypoints,
    "track-map": TrackMap,
    "track-raceline": TrackRaceline,
    "track-torcs": TrackTorcs,
    "track-geojson": TrackGeoJson,
    "track-opendrive": TrackOpenDrive,
    "config": RunConfig,
    "checkpoint": Checkpoint,
    "log": LogFile,
    "results": Results,
}
HEADER = ("parser", "inputs", "accepted", "refused", "faults", "slowest", "peak memory", "time")
IN_MEMORY = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Where files are written faster than to a disk; None for the usual place."""
MOST_SHOWN = 5
"""Faults of a parser that are printed."""


@dataclass
class Tally:
    """What came of a parser's inputs.

    Attributes:
        accepted: how many it took.
        refused: how many it refused with CarrlError.
        faults: by number of the input.
        slowest_s: processor time of the slowest, s.
    """

    accepted: int = 0
    refused: int = 0
    faults: dict[int, str] = field(default_factory=dict)
    slowest_s: float = 0.0


def main(argv: list[str] | None = None) -> int:
    """Fuzzes and prints a table; returns 0, or 1 where anything but CarrlError came out."""
    arguments = _parse(argv)
    names = list(PARSERS) if arguments.parser == "all" else [arguments.parser]
    print(machine_line(describe_machine()) + "\n")
    rows, faults = [], []
    for name in names:
        began = time.perf_counter()
        tally = fuzz(name, int(arguments.inputs), arguments.seed, arguments.only)
        seconds = time.perf_counter() - began
        rows.append(_row(name, tally, seconds))
        faults += [
            f"FAULT in {name}, input {number}: {what[:300]}; "
            f"again: scripts/fuzz {name} --seed {arguments.seed} --only {number}"
            for number, what in list(tally.faults.items())[:MOST_SHOWN]
        ]
    print(figures.markdown_table(HEADER, rows))
    print("\n".join(faults))
    return int(bool(faults))


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("parser", choices=(*PARSERS, "all"), metavar="PARSER", help=f"{', '.join(PARSERS)} or all")
    parser.add_argument("--inputs", type=positive(int), default=100_000, metavar="N", help="for each parser")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the inputs")
    parser.add_argument("--only", type=int, metavar="NUMBER", help="only this input")
    return parser.parse_args(argv)


def fuzz(name: str, inputs: int, seed: int, only: int | None = None) -> Tally:
    """Feeds one parser."""
    tally = Tally()
    with tempfile.TemporaryDirectory(dir=IN_MEMORY) as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        parser = PARSERS[name](Path(folder))
        for number in range(inputs) if only is None else [only]:
            verdict = judge(parser, seed, number)
            tally.slowest_s = max(tally.slowest_s, verdict.seconds)
            if verdict.fault is not None:
                tally.faults[number] = verdict.fault
            elif verdict.accepted:
                tally.accepted += 1
            else:
                tally.refused += 1
            if (number + 1) % 10_000 == 0:
                tell(f"{name}: {number + 1:,} of {inputs:,} inputs, {len(tally.faults)} faults")
    return tally


def _row(name: str, tally: Tally, seconds: float) -> list[str]:
    faults = len(tally.faults)
    return [
        name,
        f"{tally.accepted + tally.refused + faults:,}",
        f"{tally.accepted:,}",
        f"{tally.refused:,}",
        f"{faults:,}",
        f"{tally.slowest_s:.2f} s",
        f"{peak_mib():.0f} MiB",
        f"{seconds / 60:.1f} min",
    ]


if __name__ == "__main__":
    sys.exit(main())
