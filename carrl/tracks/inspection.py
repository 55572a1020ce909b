"""Measures a track and finds what would keep a car from lapping it.

Shapes: `P` points of the centreline, `S` walls, `G` gates, `K` pairs. A *station* is a distance along the centreline.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import shapely
from torch import Tensor

from carrl.tracks.bridges import Bridge, count_folds, find_crossings, on_two_decks
from carrl.tracks.centreline import gap_of, normals, segment_normals, turns

BODY_RADIUS = 0.5
"""Of the car that must fit through, m; that of the default vehicle."""
MOST_FAULTS_OF_A_KIND = 5
MOST_PAIRS = 2**14
"""Of lines that cross, of a kind, after which no more are looked for."""
_SAME_PLACE = 25.0
"""Faults of a kind within this distance along the road are told as one, m."""
_CORNER = math.radians(20)
"""A turn at one point from which on the road is measured on both sides of it, rad."""
_GATE_END = 0.02
"""A gate begins and ends on walls, so this share at both its ends does not count as crossing them."""


class _Track(Protocol):
    """What is looked at of a `Track`, which is defined in a module that uses this one."""

    @property
    def name(self) -> str: ...
    @property
    def length(self) -> float: ...
    @property
    def centreline(self) -> Tensor: ...
    @property
    def left_wall(self) -> Tensor: ...
    @property
    def right_wall(self) -> Tensor: ...
    @property
    def walls(self) -> Tensor: ...
    @property
    def wall_stations(self) -> Tensor: ...
    @property
    def gates(self) -> Tensor: ...
    @property
    def gate_stations(self) -> Tensor: ...
    @property
    def gate_count(self) -> int: ...
    @property
    def bridges(self) -> tuple[Bridge, ...]: ...
    @property
    def repeats(self) -> int: ...


@dataclass(frozen=True)
class TrackReport:
    """What a track measures, and its faults.

    Attributes:
        name: of the track.
        length: of the centreline, m.
        width_min: least distance between the two walls beside a point of the centreline, square to the road, m.
        width_max: the largest one, m.
        least_radius_left: of the centreline in turns to the left, m; None where it has none.
        least_radius_right: in turns to the right.
        points: of the centreline.
        repeats: how many more the file had that repeated the one before.
        walls: how many.
        gates: how many.
        bridges: where the road crosses itself.
        folds: how many folds of a wall were cut.
        faults: a sentence for each; none on a sound track.
    """

    name: str
    length: float
    width_min: float
    width_max: float
    least_radius_left: float | None
    least_radius_right: float | None
    points: int
    repeats: int
    walls: int
    gates: int
    bridges: tuple[Bridge, ...]
    folds: int
    faults: tuple[str, ...]


def inspect_track(track: _Track, body_radius: float = BODY_RADIUS) -> TrackReport:
    """Measures a track and lists its faults.

    Args:
        track: any.
        body_radius: of the car that must fit through, m.
    """
    left, right = track.left_wall.double().numpy(), track.right_wall.double().numpy()
    centreline = track.centreline.double().numpy()
    widths, curvature = road_widths(centreline, left, right), _curvature(centreline)
    return TrackReport(
        name=track.name,
        length=track.length,
        width_min=float(widths.min()),
        width_max=float(widths.max()),
        least_radius_left=_radius(curvature.max()),
        least_radius_right=_radius(-curvature.min()),
        points=len(track.centreline),
        repeats=track.repeats,
        walls=len(track.walls),
        gates=track.gate_count,
        bridges=track.bridges,
        folds=count_folds(left) + count_folds(right),
        faults=tuple(_find_faults(track, widths, body_radius)),
    )


def road_widths(centreline: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """From wall to wall beside each point, square to the road, at a corner to the narrower side of it: [P], m."""
    across, square = left - right, segment_normals(centreline)
    after = np.abs((across * square).sum(axis=1))
    before = np.abs((across * np.roll(square, 1, axis=0)).sum(axis=1))
    abreast = np.abs((across * normals(centreline)).sum(axis=1))
    return np.where(np.abs(turns(centreline)) > _CORNER, np.minimum(before, after), abreast)


def _curvature(points: np.ndarray) -> np.ndarray:
    """Signed curvature of the circle through each point [P, 2] and its neighbours, [P], 1/m, positive to the left."""
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    area = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    lengths = [np.linalg.norm(side, axis=1) for side in (before, after, before + after)]
    return np.asarray(2 * area / np.maximum(np.prod(lengths, axis=0), 1e-12))


def _radius(curvature: float) -> float | None:
    """The radius, m, of a curvature; None for a straight, which float32 draws as a curve of some kilometres."""
    return 1 / float(curvature) if curvature > 1e-4 else None


def _find_faults(track: _Track, widths: np.ndarray, body_radius: float) -> list[str]:
    lines = _Lines(track)
    gap = gap_of(track.centreline.double().numpy())
    faults = [] if gap is None else [gap]
    narrowest = int(widths.argmin())
    if widths[narrowest] <= 2 * body_radius:
        faults.append(
            f"the road is {widths[narrowest]:.2f} m wide at {lines.point_stations[narrowest]:.0f} m; "
            f"a car {2 * body_radius:g} m wide does not fit"
        )
    faults += _told("the walls cross each other", lines.crossing_walls())
    faults += _told("a wall cuts the road", lines.walls_across_the_road())
    faults += _told("a gate runs through a wall", lines.walls_across_gates())
    faults += _told("two gates cross each other", lines.crossing_gates())
    return faults


class _Lines:
    """The walls, the centreline's segments and the gates of a track as geometry, and which of them cross.

    Each answer is a list of pairs of stations, without those that a bridge keeps apart.
    """

    def __init__(self, track: _Track) -> None:
        self._track = track
        self._ends = track.walls.double().numpy()
        self._walls = shapely.linestrings(self._ends)
        self._wall_stations = track.wall_stations.numpy()
        middle = track.centreline.double().numpy()
        steps = np.linalg.norm(np.roll(middle, -1, axis=0) - middle, axis=1)
        self.point_stations = np.concatenate([[0], steps.cumsum()[:-1]])
        self._middle = shapely.linestrings(np.stack([middle, np.roll(middle, -1, axis=0)], axis=1))
        self._middle_stations = self.point_stations + steps / 2
        gates = track.gates.double().numpy()
        inset = _GATE_END * (gates[:, 1] - gates[:, 0])
        self._gates = shapely.linestrings(np.stack([gates[:, 0] + inset, gates[:, 1] - inset], axis=1))
        self._gate_stations = track.gate_stations.numpy()

    def crossing_walls(self) -> np.ndarray:
        """Of walls that meet although neither begins where the other ends, [K, 2]."""
        begins, ends = self._ends[:, 0], self._ends[:, 1]

        def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
            joined = (ends[one] == begins[other]).all(axis=1) | (ends[other] == begins[one]).all(axis=1)
            return np.asarray((one < other) & ~joined)

        one, other = find_crossings(self._walls, self._walls, apart, MOST_PAIRS).T
        return self._on_one_level(self._wall_stations[one], self._wall_stations[other])

    def walls_across_the_road(self) -> np.ndarray:
        """Of places on the centreline and the walls that cross it there, [K, 2]."""
        place, wall = find_crossings(self._middle, self._walls, _any, MOST_PAIRS).T
        return self._on_one_level(self._middle_stations[place], self._wall_stations[wall])

    def walls_across_gates(self) -> np.ndarray:
        """Of gates and the walls that cross them, [K, 2]."""
        gate, wall = find_crossings(self._gates, self._walls, _any, MOST_PAIRS).T
        return self._on_one_level(self._gate_stations[gate], self._wall_stations[wall])

    def crossing_gates(self) -> np.ndarray:
        """Of gates that cross each other, [K, 2]."""
        one, other = find_crossings(self._gates, self._gates, lambda one, other: one < other, MOST_PAIRS).T
        return self._on_one_level(self._gate_stations[one], self._gate_stations[other])

    def _on_one_level(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        apart = on_two_decks(self._track.bridges, self._track.length, one, other)
        return np.stack([one[~apart], other[~apart]], axis=1)


def _any(one: np.ndarray, _other: np.ndarray) -> np.ndarray:
    return np.ones(len(one), dtype=bool)


def _told(what: str, places: np.ndarray) -> list[str]:
    """A sentence for each pair of places, stations [K, 2], m, that is not near one told before."""
    told: list[tuple[float, float]] = []
    squares: dict[tuple[int, int], list[tuple[float, float]]] = {}  # what was told, by squares of that distance
    for one, other in np.sort(places, axis=1).tolist():
        square = int(one // _SAME_PLACE), int(other // _SAME_PLACE)
        around = [(square[0] + x, square[1] + y) for x in (-1, 0, 1) for y in (-1, 0, 1)]
        near = (before for each in around for before in squares.get(each, ()))
        if all(max(abs(one - first), abs(other - second)) > _SAME_PLACE for first, second in near):
            told.append((one, other))
            squares.setdefault(square, []).append((one, other))
    sentences = [f"{what} at {one:.0f} m and {other:.0f} m" for one, other in told[:MOST_FAULTS_OF_A_KIND]]
    more = len(told) - len(sentences)
    return [*sentences, *([f"{what} at {more} more places"] if more else [])]
