"""What a car-step costs with several cars in a world: `python -m benchmarks.sim_traffic` prints nanoseconds as JSON.

Cars begin one behind the other, anywhere on the road, and drive at random; where one of them touches anything, its
whole world begins anew. The numbers of cars take turns, in one process. What counts is the time that the processor
takes for the simulator's steps; putting back cars that have ended is no part of it.
"""

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from statistics import median

import torch
from torch import Tensor

from benchmarks.child import run_child
from benchmarks.sim_cells import WARM_UP
from benchmarks.sim_drives import SEED
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome
from carrl.sim.single_track import SingleTrack
from carrl.task.action import ContinuousActions, steer3
from carrl.task.episode import Start
from carrl.task.task import Task, make_task
from carrl.tracks.track import Track

CARS = 4032
"""In all, about; a multiple of most numbers of cars a world."""
TITLES = {
    "paper": "the paper's car, 7 rays of 10 m",
    "race": "single_track, 19 rays of 80 m",
}
Cost = Mapping[str, Mapping[int, Sequence[float]]]
"""Nanoseconds of a car-step in each round, by the name of the setting and the number of cars a world."""


def measure_worlds(track: str, counts: Sequence[int], seconds: float, rounds: int) -> Cost:
    """Measures in a process of its own.

    Raises:
        BenchError: it failed.
    """
    options = ["--counts", ",".join(map(str, counts)), "--seconds", str(seconds), "--rounds", str(rounds)]
    output, _ = run_child(["-m", "benchmarks.sim_traffic", "--track", track, *options])
    found = json.loads(output.splitlines()[-1])
    return {name: {int(count): costs for count, costs in by_count.items()} for name, by_count in found.items()}


def table(cost: Cost) -> tuple[list[str], list[list[str]]]:
    """Header and rows: medians, and by how much they are more than with the first number of cars."""
    header = ["car, sensor", "cars a world", "ns a car-step", "min..max", "more than alone"]
    rows = []
    for name, by_count in cost.items():
        first = next(iter(by_count.values()))
        for count, costs in by_count.items():
            more = 100 * (median(costs) / median(first) - 1)
            spread = f"{min(costs):.0f}..{max(costs):.0f}"
            rows.append([TITLES[name], str(count), f"{median(costs):.0f}", spread, f"{more:+.0f} %"])
    return header, rows


def _task(name: str, track: Track, count: int) -> Task:
    cars, start = CARS // count * count, Start(anywhere=True, speed=10.0 if name == "race" else 0.0)
    parts = {} if name == "paper" else {"vehicle": SingleTrack(), "action": ContinuousActions()}
    sensor = Sensor() if name == "paper" else Sensor(rays=19, max_range=80.0)
    return make_task(track, cars, [SEED], sensor=sensor, start=start, cars_per_world=count, **parts)  # type: ignore[arg-type]


def make_drive(name: str, track: Track, count: int) -> tuple[Callable[[], float], int]:
    """What drives one step of all cars in worlds of so many and says how long that took, s; how many cars those are."""
    task, generator = _task(name, track, count), torch.Generator().manual_seed(SEED)
    simulator, cars = task.simulator, task.cars
    start = task.start().state.cars
    if name == "paper":
        controls = cycle([steer3().controls(torch.randint(3, (cars,), generator=generator)) for _ in range(16)])
    else:
        controls = cycle([2 * torch.rand(cars, 2, generator=generator) - 1 for _ in range(16)])
    state = start

    def drive() -> float:
        nonlocal state
        control, began = next(controls), time.process_time()
        outcome = simulator.step(state, control)
        took = time.process_time() - began
        state = _put_back(_ended(outcome, count), start, outcome.cars)
        return took

    return drive, cars


def _ended(outcome: Outcome, count: int) -> Tensor:
    """The cars in whose worlds one touched something, [N]."""
    ends = outcome.collided if outcome.contact is None else outcome.collided | outcome.contact.touched
    return ends if count == 1 else ends.view(-1, count).any(dim=1).repeat_interleave(count)


def _put_back(ended: Tensor, start: CarState, now: CarState) -> CarState:
    if not bool(ended.any()):
        return now
    row = ended.nonzero()[:, 0]
    return now.map(lambda own, theirs: own.index_copy(0, row, theirs), start[row])


def _cost(drive: Callable[[], float], cars: int, seconds: float) -> float:
    """Nanoseconds of a car-step, of steps that take so long in all."""
    steps, elapsed = 0, 0.0
    while elapsed < seconds:
        elapsed += drive()
        steps += 1
    return elapsed / steps / cars * 1e9


def main(argv: list[str] | None = None) -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sim_traffic")
    parser.add_argument("--track", required=True)
    parser.add_argument("--counts", required=True, help="numbers of cars a world, with commas between")
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--rounds", type=int, required=True)
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    track, counts = Track.load(arguments.track), [int(count) for count in arguments.counts.split(",")]
    found: dict[str, dict[int, list[float]]] = {}
    with torch.no_grad():
        for name in TITLES:
            drives = {count: make_drive(name, track, count) for count in counts}
            for drive in drives.values():
                _cost(*drive, WARM_UP * arguments.seconds)
            found[name] = {count: [] for count in counts}
            for _ in range(arguments.rounds):
                for count, drive in drives.items():
                    found[name][count].append(_cost(*drive, arguments.seconds))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
