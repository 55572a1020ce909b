"""Drives one contestant with every number of cars on every track: `python -m benchmarks.sim_cells NAME ...`."""

import argparse
import contextlib
import cProfile
import json
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass

import torch

from benchmarks.child import run_child
from benchmarks.sim_drives import CONTESTANTS, Contestant, Drive, LeftOutError
from carrl.tracks.track import Track

PAPER = "paper"
WARM_UP = 0.3
"""Share of the measured time that is driven before it."""
LONGEST_CALL_S = 3.0
"""A number of cars is left out if fewer of them foretell that one step of all takes longer."""


@dataclass(frozen=True)
class Cell:
    """One contestant with so many cars on a track, in one round.

    Attributes:
        track: as it was named on the command line.
        cars: driven side by side.
        steps: car-steps made.
        seconds: wall time they took.
    """

    track: str
    cars: int
    steps: int
    seconds: float

    @property
    def steps_per_s(self) -> float:
        """Car-steps for each second of wall time."""
        return self.steps / self.seconds


@dataclass(frozen=True)
class Course:
    """What every contestant has to drive.

    Attributes:
        tracks: what `Track.load` takes; the first is the one that others are compared with.
        cars: how many side by side, from few to many.
        seconds: how long each is driven.
    """

    tracks: Sequence[str]
    cars: Sequence[int]
    seconds: float


def measure(name: str, course: Course) -> list[Cell]:
    """Drives in a process of its own.

    Raises:
        LeftOutError: the contestant is not there.
        BenchError: it failed.
    """
    output, _ = run_child(child_arguments(name, course))
    found = json.loads(output.splitlines()[-1])
    if isinstance(found, str):
        raise LeftOutError(found)
    return [Cell(**each) for each in found]


def child_arguments(name: str, course: Course) -> list[str]:
    """What Python is called with to drive in another process."""
    tracks = [word for track in course.tracks for word in ("--track", track)]
    cars = ",".join(map(str, course.cars))
    return ["-m", "benchmarks.sim_cells", name, *tracks, "--cars", cars, "--seconds", str(course.seconds)]


def drive_course(
    contestant: Contestant, course: Course, watch: AbstractContextManager[object] | None = None
) -> list[Cell]:
    """Measures with few cars first; the tracks take turns, so that they can be compared.

    Args:
        contestant: who drives.
        course: what.
        watch: around all that is measured, and nothing else.
    """
    watch = watch or contextlib.nullcontext()
    tracks = {name: Track.load(name) for name in ([PAPER] if contestant.paper_only else course.tracks)}
    call_s_per_car = dict.fromkeys(tracks, 0.0)
    cells: list[Cell] = []
    for cars in [1] if contestant.one_car else course.cars:
        for name, track in tracks.items():
            if call_s_per_car[name] * cars > LONGEST_CALL_S:
                continue
            drive = contestant.make(track, cars)
            drive_for(drive, WARM_UP * course.seconds)
            with watch:
                steps, seconds, call_s = drive_for(drive, course.seconds)
            call_s_per_car[name] = call_s / cars
            cells.append(Cell(name, cars, steps, seconds))
    return cells


def drive_for(drive: Drive, seconds: float) -> tuple[int, float, float]:
    """Drives for so long, but at least once; returns the car-steps, the seconds they took, and those of one call."""
    steps, calls, began = 0, 0, time.perf_counter()
    while True:
        steps += drive()
        calls += 1
        elapsed = time.perf_counter() - began
        if elapsed >= seconds:
            return steps, elapsed, elapsed / calls


def main(argv: list[str] | None = None) -> None:
    """Drives and prints the cells as JSON, or why there are none."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sim_cells")
    parser.add_argument("name", choices=sorted(CONTESTANTS))
    parser.add_argument("--track", action="append", required=True)
    parser.add_argument("--cars", required=True, help="numbers with commas between, from few to many")
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--profile", metavar="FILE", help="drive under cProfile and write down what it saw")
    arguments = parser.parse_args(argv)
    course = Course(arguments.track, [int(cars) for cars in arguments.cars.split(",")], arguments.seconds)
    torch.set_num_threads(1)
    profile = cProfile.Profile() if arguments.profile else None
    try:
        with torch.no_grad():
            cells = drive_course(CONTESTANTS[arguments.name], course, profile)
        if profile:
            profile.dump_stats(arguments.profile)
    except LeftOutError as reason:
        print(json.dumps(str(reason)))
    else:
        print(json.dumps([asdict(cell) for cell in cells]))


if __name__ == "__main__":
    main()
