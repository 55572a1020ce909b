"""`scripts/bench rays`: compares rays with brute force over all walls, and states the memory of each track."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from benchmarks import figures
from benchmarks.child import CIRCUITS
from benchmarks.options import Parser, positive, tell
from carrl.errors import CarrlError
from carrl.sim.collision_geometry import TrackLayout
from carrl.sim.geometry import ray_distances
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.track import Track, builtin_names

HEADER = ("track", "walls", "KiB", "rays", "more than 1 mm off", "largest difference, m")
TOLERANCE = 1e-3
OFF_ROAD = 0.1
"""Share of the cars that stand anywhere on the map instead of on the road."""
_WORK = 4_000_000
"""Pairs of a ray and a wall compared by brute force at once; they take 32 bytes and more each."""


@dataclass(frozen=True)
class Comparison:
    """What was found on one track.

    Attributes:
        track: its name.
        walls: of all its decks.
        memory: that its walls, gates and grid take, bytes.
        rays: how many were compared.
        off: how many of them differ by more than `TOLERANCE`.
        largest: difference, m.
    """

    track: str
    walls: int
    memory: int
    rays: int
    off: int
    largest: float


def main(argv: list[str] | None = None) -> int:
    """Compares and prints; returns 0, or 1 if any ray was off."""
    parser = Parser(prog="scripts/bench rays", description=__doc__)
    parser.add_argument("--rays", type=positive(int), default=100_000, metavar="N", help="on each track")
    parser.add_argument("--random", type=int, default=50, metavar="N", help="how many random tracks, from seed 0 on")
    parser.add_argument("--range", type=positive(float), default=Sensor().max_range, metavar="M", help="of the rays, m")
    parser.add_argument(
        "--folder", type=Path, default=CIRCUITS, metavar="DIR", help="of circuits (CSV) to be added, if it is there"
    )
    parser.add_argument("--markdown", action="store_true", help="print a table for a page")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    try:
        found = [
            compare(track, arguments.rays, arguments.range) for track in _tracks(arguments.folder, arguments.random)
        ]
    except CarrlError as error:
        parser.error(str(error))
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    print(table(HEADER, [_row(each) for each in found]))
    return int(any(each.off for each in found))


def _tracks(folder: Path, random: int) -> Iterator[Track]:
    yield from map(Track.load, builtin_names())
    yield from map(Track.load, sorted(folder.glob("*.csv")))
    yield from map(Track.random, range(random))


def compare(track: Track, rays: int, max_range: float) -> Comparison:
    """Casts rays from random places on a track, and compares them with brute force.

    Args:
        track: each of its decks gets its share of the cars.
        rays: at least so many.
        max_range: of the rays, m.
    """
    sensor = Sensor(max_range=max_range)
    simulator = Simulator(track, Vehicle(), sensor)
    plot = TrackLayout.of_track(track, max(max_range, 1.5))
    cars, generator = -(-rays // sensor.rays), torch.Generator().manual_seed(0)
    state = CarState.at(_poses(track, cars, generator))
    gates = [(plot.deck_of_gate == deck).nonzero()[0, 0] for deck in range(len(plot.visible))]
    state = replace(state, next_gate=torch.stack(gates)[torch.arange(cars) % len(gates)])
    ranges, off, largest = simulator.sense(state), 0, 0.0
    tell(f"{track.name}: {ranges.numel():,} rays among {len(track.walls):,} walls")
    for deck, visible in enumerate(plot.visible):
        own, walls = (torch.arange(cars) % len(gates) == deck).nonzero()[:, 0], track.walls[visible]
        for some in own.split(max(1, _WORK // (sensor.rays * len(walls)))):
            pose = state.pose[some]
            truth = ray_distances(pose[:, :2], pose[:, 2:].double() + sensor.angles.double(), walls, max_range)
            difference = (ranges[some] - truth).abs()
            off += int((difference > TOLERANCE).sum())
            largest = max(largest, difference.max().item())
    return Comparison(track.name, len(track.walls), simulator.geometry.bytes, ranges.numel(), off, largest)


def _poses(track: Track, count: int, generator: torch.Generator) -> torch.Tensor:
    """Poses [count, 3] across the whole width of the road, and a few anywhere on the map."""
    stations = torch.rand(count, generator=generator, dtype=torch.float64) * track.length
    pose, (right, left) = track.pose_at(stations), track.clearance_at(stations).flip(1).T
    sideways = -right + (left + right) * torch.rand(count, generator=generator, dtype=torch.float64)
    heading = pose[:, 2].double()
    pose[:, :2] += (sideways * torch.stack([-heading.sin(), heading.cos()])).T
    low, high = track.walls.flatten(0, 1).amin(0), track.walls.flatten(0, 1).amax(0)
    away = round(OFF_ROAD * count)
    pose[:away, :2] = low + (high - low) * torch.rand(away, 2, generator=generator)
    pose[:, 2] = torch.pi * (2 * torch.rand(count, generator=generator) - 1)
    return pose


def _row(found: Comparison) -> Sequence[str]:
    memory = f"{found.memory / 1024:,.0f}"
    return [found.track, f"{found.walls:,}", memory, f"{found.rays:,}", f"{found.off:,}", f"{found.largest:.1g}"]


if __name__ == "__main__":
    sys.exit(main())
