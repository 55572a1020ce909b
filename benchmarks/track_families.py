"""Which track files of folders load, which have faults, and which the hand-written rule laps with a car that fits.

    python -m benchmarks.track_families FOLDER... [--width M] [--starts N]

The car is sized by the narrowest place of each road: a disc of 0.15 of its width, 0.05 of it a step, turning in circles
of 0.35 of it at the tightest, with seven rays as long as the road is wide.
"""

import argparse
import re
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import figures
from benchmarks.options import Parser, positive, tell
from carrl.errors import CarrlError, TrackError
from carrl.evaluation.baselines import rule_policy
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import Vehicle
from carrl.task.action import steer3
from carrl.task.observation import rays_only
from carrl.task.reward import paper_reward
from carrl.task.task import World
from carrl.tracks.circuits import Circuits
from carrl.tracks.inspection import inspect_track
from carrl.tracks.library import files_below
from carrl.tracks.track import Track

HEADER = ("folder", "files", "circuits", "with faults", "refused", "lapped", "slowest load")
MOST_SHOWN = 8


class Family(NamedTuple):
    """What came of a folder's files.

    Attributes:
        files: how many there are.
        circuits: in those that load.
        faults: of circuits that have some, by name.
        refused: the sentence for each file that does not load.
        not_lapped: circuits, and how much of the lap was driven from the worst start.
        slowest: load, s of processor time.
    """

    files: int
    circuits: int
    faults: dict[str, str]
    refused: dict[str, str]
    not_lapped: dict[str, str]
    slowest: float


def main(argv: list[str] | None = None) -> int:
    """Prints the table, and below it what each file is refused for; returns 0."""
    arguments = _parse(argv)
    rows, notes = [], []
    for folder in arguments.folders:
        tell(f"{folder} ...")
        family = survey(Path(folder), arguments.width, int(arguments.starts))
        lapped = family.circuits - len(family.not_lapped)
        counts = (family.files, family.circuits, len(family.faults), len(family.refused), lapped)
        rows.append([folder, *map(str, counts), f"{family.slowest:.2f} s"])
        for what in ("faults", "refused", "not_lapped"):
            notes += _told(f"{folder}, {what.replace('_', ' ')}", getattr(family, what))
    print(figures.markdown_table(HEADER, rows))
    print("\n".join(notes))
    return 0


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = Parser(prog="python -m benchmarks.track_families", description=__doc__)
    parser.add_argument("folders", nargs="+", metavar="FOLDER")
    parser.add_argument("--width", type=positive(float), metavar="M", help="of the roads in files without widths, m")
    parser.add_argument("--starts", type=positive(int), default=4, metavar="N", help="of the rule on each circuit")
    return parser.parse_args(argv)


def survey(folder: Path, width: float | None, starts: int) -> Family:
    """Loads, inspects and laps all circuits of a folder."""
    faults, refused, not_lapped, circuits, slowest = {}, {}, {}, 0, 0.0
    files = list(files_below(folder))
    for path in files:
        began = time.process_time()
        try:
            tracks = _load(path, width)
        except CarrlError as error:
            refused[path.name] = str(error)
            continue
        slowest = max(slowest, time.process_time() - began)
        for track in tracks:
            circuits += 1
            report = inspect_track(track, body_radius=0.15 * _narrowest(track))
            if report.faults:
                faults[track.name] = "; ".join(report.faults)
            progress = lap(track, starts)
            if progress < 1:
                not_lapped[track.name] = f"{progress:.0%} of the lap"
    return Family(len(files), circuits, faults, refused, not_lapped, slowest)


def _load(path: Path, width: float | None) -> list[Track]:
    try:
        return Track.load_all(path)
    except TrackError as error:
        if width is None or "track.width" not in str(error):
            raise
        return Track.load_all(path, width=width)


def _narrowest(track: Track) -> float:
    return inspect_track(track, body_radius=0.0).width_min


def lap(track: Track, starts: int) -> float:
    """How much of a lap the rule drives with a car that fits, 0..1, from the worst of some starts."""
    width = _narrowest(track)
    car = Vehicle(speed=0.5 * width, time_step=0.1, turn_radius=0.35 * width, body_radius=0.15 * width / 2)
    sensor = Sensor(max_range=width)
    world = World(Circuits.only(track), car, sensor, steer3(), rays_only(), paper_reward())
    drives = rollout_laps(world, world.simulator(track), rule_policy, starts=starts)
    return min(1.0 if each.lap_completed else min(each.progress, 0.999) for each in drives)


def _told(what: str, sentences: dict[str, str]) -> list[str]:
    """A line for each file, and one for the rest of many; files with the same sentence together."""
    alike: dict[str, list[str]] = {}
    for name, sentence in sentences.items():
        alike.setdefault(re.sub(rf"{re.escape(name)}|[\d.]+", "*", sentence), []).append(f"{name}: {sentence}")
    lines = [f"- {what}, {len(each)} like {each[0]}" for each in alike.values()]
    return lines[:MOST_SHOWN] + ([f"- {what}, {len(lines) - MOST_SHOWN} more kinds"] if len(lines) > MOST_SHOWN else [])


if __name__ == "__main__":
    sys.exit(main())
