"""A road given by its centreline and its widths; and places along the centrelines of any number of tracks, end to end.

Shapes: `T` tracks, `P` points, `G` gates of all tracks, `B` cars. Lengths are in metres, angles in radians
counter-clockwise from +x. A *station* is a distance along one centreline from its start line, in driving order; a
*milestone* is a distance along all of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

MAX_FILE_BYTES = 16 * 2**20
"""Of a track's file."""
MIN_POINTS = 3
MOST_POINTS = 100_000
MIN_STEP = 0.01
"""Least distance between neighbouring points, m; together with MAX_COORDINATE it keeps them apart in float32."""
MAX_COORDINATE = 1e5
MITRED = math.radians(44), math.radians(150)
"""Turns at one point, rad, that are corners drawn by hand: more than any of a real circuit with points 5 m apart (43
degrees at Shanghai), and less than a spike, whose mitre would have no end."""
LONGEST_GAP, LONGEST_STEP = 5.0, 1.5
"""From the last point of a closed line to its first, in longest other steps. Of 205 real circuits it is at most 2.1; of
a line that is not closed it was 21. Where the road crosses itself, the second one is enough to blame the gap."""


@dataclass(frozen=True)
class Road:
    """What a track's file gives: a closed road between two walls, in driving order.

    Attributes:
        centre: of the road, [P, 2], m.
        left: the left wall beside each of its points, [P, 2], m.
        right: the right wall, [P, 2], m.
        repeats: how many points were left out, since they repeated the one before.
        gates: how many, or None.
        gate_spacing: about how far they stand apart, m, or None.
        name: of the circuit, where its file has many.
        notes: how its file was read, where there was a choice; a phrase for each.
        reference: the line that its file proposes to drive, in driving order, [N, 2], m; or None.
    """

    centre: np.ndarray
    left: np.ndarray
    right: np.ndarray
    repeats: int = 0
    gates: int | None = None
    gate_spacing: float | None = None
    name: str | None = None
    notes: tuple[str, ...] = ()
    reference: np.ndarray | None = None


@dataclass(frozen=True)
class Centreline:
    """A closed line in driving order; the last point joins the first.

    Attributes:
        points: [P, 2], float64, m.
        width_right: from the centreline to the right wall, [P], m.
        width_left: from the centreline to the left wall, [P], m.
        repeats: how many points of a file were left out, since they repeated the one before.
    """

    points: np.ndarray
    width_right: np.ndarray
    width_left: np.ndarray
    repeats: int = 0

    def walls(self) -> tuple[np.ndarray, np.ndarray]:
        """The left and the right wall, [P, 2] each, m: the points moved sideways by the widths, corners mitred."""
        to_left = normals(self.points)
        left, right = (
            self.points + to_left * self.width_left[:, None],
            self.points - to_left * self.width_right[:, None],
        )
        _mitre(self.points, left, self.width_left)
        _mitre(self.points, right, -self.width_right)
        return left, right

    def road(self, gates: int | None = None, gate_spacing: float | None = None) -> Road:
        """The road between these walls."""
        return Road(self.points, *self.walls(), self.repeats, gates, gate_spacing)


def normals(points: np.ndarray) -> np.ndarray:
    """Unit vectors to the left, square to the line from the point before to the point after, [P, 2]."""
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def segment_normals(points: np.ndarray) -> np.ndarray:
    """Unit vectors to the left of the segments that begin at the points, [P, 2]."""
    way = np.roll(points, -1, axis=0) - points
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    return np.stack([-way[:, 1], way[:, 0]], axis=1)


def turns(points: np.ndarray) -> np.ndarray:
    """By how much the line turns at each point, [P], rad in [-pi, pi], positive to the left."""
    after = segment_normals(points)
    before = np.roll(after, 1, axis=0)
    area = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.arctan2(area, (before * after).sum(axis=1))


def _mitre(points: np.ndarray, wall: np.ndarray, offsets: np.ndarray) -> None:
    """Moves the wall's points at corners to where the offset sides meet, in place.

    An inner corner whose sides are too short to reach that place stays as it is: the wall folds there, and `cut_folds`
    finds where its sides meet.

    Args:
        points: of the centreline, [P, 2], m.
        wall: beside them, [P, 2], m.
        offsets: of the wall to the left of the centreline, [P], m.
    """
    turn = turns(points)
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    least, most = MITRED
    corner = (np.abs(turn) > least) & (np.abs(turn) < most)
    corner &= offsets * np.tan(turn / 2) <= np.minimum(steps, np.roll(steps, 1))
    after = segment_normals(points)
    across = (after + np.roll(after, 1, axis=0))[corner] / (1 + np.cos(turn[corner]))[:, None]
    wall[corner] = points[corner] + across * offsets[corner, None]


def without_repeats(table: np.ndarray) -> tuple[np.ndarray, int]:
    """The rows [P, ...], which begin with x and y, m, without repeated points, and how many there were.

    A row nearer than `MIN_STEP` to the one kept before it is a repeat, and so is one at the end that is as near to the
    first. The last row of all closes the line if it repeats the first, and is left out without being counted.
    """
    rows = drop_closing_point(table)
    if repeated_point(rows[:, :2]) is None:
        return rows, 0
    kept = [0]
    for index in range(1, len(rows)):
        if math.dist(rows[index, :2], rows[kept[-1], :2]) >= MIN_STEP:
            kept.append(index)
    while len(kept) > 1 and math.dist(rows[kept[-1], :2], rows[0, :2]) < MIN_STEP:
        kept.pop()
    return rows[kept], len(rows) - len(kept)


def gap_of(points: np.ndarray, leads_astray: bool = False) -> str | None:
    """A sentence with the gap of a line [P, 2], m, that does not return to its first point; None of a closed line.

    Args:
        points: the last one joins the first.
        leads_astray: whether that makes the road cross itself, so that a gap is told from a step with less evidence.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    gap, longest = math.dist(points[0], points[-1]), float(steps.max())
    beyond = _ends_beyond_its_start(points)
    if gap <= LONGEST_GAP * longest and not (leads_astray and (beyond or gap > LONGEST_STEP * longest)):
        return None
    remedy = (
        "end it where it begins, since it goes on past its start"
        if beyond
        else "draw it back to its first point, with points on the way"
    )
    return (
        f"the centreline is not closed: its last point is {gap:.2f} m from its first, and other neighbours are at most "
        f"{longest:.2f} m apart; {remedy}"
    )


def _ends_beyond_its_start(points: np.ndarray) -> bool:
    """Whether the last point lies ahead of the first, not far away, and the line is driven the same way at both."""
    first, last, ahead = points[1] - points[0], points[-1] - points[-2], points[-1] - points[0]
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    is_near = np.linalg.norm(ahead) < length / 4
    return bool(is_near and ahead @ first > 0 and last @ first > 0.5 * np.linalg.norm(first) * np.linalg.norm(last))


def drop_closing_point(table: np.ndarray) -> np.ndarray:
    """The rows [P, ...], which begin with x and y, m, without a last one that repeats the first point, or nearly."""
    closes = len(table) > 1 and np.linalg.norm(table[0, :2] - table[-1, :2]) < MIN_STEP
    return table[:-1] if closes else table


def repeated_point(points: np.ndarray) -> int | None:
    """Index of a point [P, 2], m, that stands nearer than `MIN_STEP` to the next one; None where there is none."""
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    return int(steps.argmin()) if (steps < MIN_STEP).any() else None


_AT_GATE = 0.1
"""A start this close before a gate, m, lies behind it: where the widths change, the gate's straight line between the
walls meets the centreline some centimetres off its station (4 cm on the Moscow Raceway)."""
_SEARCH_SAMPLES = 257


class Routes:
    """The centrelines of tracks, on the CPU. Stations may be negative or more than a lap.

    It computes in NumPy, which takes half as long as torch for the few cars that start at a time.

    Args:
        roads: points of the centreline, the left and the right wall of each track, [P, 3, 2], float32, m.
        gate_counts: how many gates each track has.

    Attributes:
        lengths: of the centrelines, [T], float64, m.
        segment_middles: milestones of the middles of the centrelines' segments, [P], float64, m.
    """

    def __init__(self, roads: Sequence[Tensor], gate_counts: Sequence[int]) -> None:
        """Lays the centrelines end to end."""
        begin, end = torch.cat(list(roads)), torch.cat([road.roll(-1, 0) for road in roads])
        way = (end - begin)[:, 0]
        steps = torch.linalg.vector_norm(way.double(), dim=1).split([len(road) for road in roads])
        stations = [torch.cat([each.new_zeros(1), each.cumsum(0)]) for each in steps]
        self.lengths = torch.stack([each[-1] for each in stations])
        bases = self.lengths.cumsum(0) - self.lengths
        segment_begin = torch.cat([base + each[:-1] for base, each in zip(bases, stations, strict=True)])
        segment_end = torch.cat([base + each[1:] for base, each in zip(bases, stations, strict=True)])
        self.segment_middles = (segment_begin + segment_end) / 2
        # A copy: torch moves a tensor's memory when it hands the tensor to another process.
        self._lengths, self._bases = self.lengths.numpy().copy(), bases.numpy()
        self._headings = torch.atan2(way[:, 1], way[:, 0]).numpy()
        self._begin, self._edge = begin.double().numpy(), (end.double() - begin.double()).numpy()
        self._segment_begin, self._segment_end = segment_begin.numpy(), segment_end.numpy()
        self._last_segment = np.cumsum([len(road) for road in roads]) - 1
        self._gate_counts = np.array(gate_counts)
        self._first_gate = self._gate_counts.cumsum() - self._gate_counts
        self._gates = np.concatenate([base + self.gates_of(index).numpy() for index, base in enumerate(self._bases)])

    def gates_of(self, track: int) -> Tensor:
        """Stations of the gates of one track: evenly spaced, the last at its length, [G], float64, m."""
        count = int(self._gate_counts[track])
        return torch.arange(1, count + 1, dtype=torch.float64) * self.lengths[track] / count

    def poses(self, track: Tensor, stations: Tensor) -> Tensor:
        """Poses on the centreline, in the driving direction: [B] and [B], m, to [B, 3], float32, m, m, rad."""
        segment, points = self._points_at(track.numpy(), stations.numpy())
        poses = np.empty((len(segment), 3), np.float32)
        poses[:, :2], poses[:, 2] = points[:, 0], self._headings[segment]
        return torch.from_numpy(poses)

    def walls(self, track: Tensor, stations: Tensor) -> Tensor:
        """Where the left and the right wall stand, at stations [B], m: [B, 2, 2], float64, m."""
        return torch.from_numpy(self._points_at(track.numpy(), stations.numpy())[1][:, 1:])

    def clearance(self, track: Tensor, stations: Tensor) -> Tensor:
        """How far the walls are from the centreline, left and right: [B] and [B], m, to [B, 2], float64, m.

        Measured square to the heading of `poses`, so that a car can be moved sideways by that much.
        """
        segment, found = self._points_at(track.numpy(), stations.numpy())
        heading, points = torch.from_numpy(self._headings[segment]).double(), torch.from_numpy(found)
        to_left = torch.stack([-heading.sin(), heading.cos()], dim=-1)[:, None]
        outward = points.new_tensor([1.0, -1.0])
        return (((points[:, 1:] - points[:, :1]) * to_left).sum(-1) * outward).clamp(min=0)

    def next_gate(self, track: Tensor, stations: Tensor) -> Tensor:
        """Index of the first gate ahead of each station: [B] and [B], m, to [B]; one within 0.1 m lies behind."""
        own = track.numpy()
        ahead = self._gates.searchsorted(self._milestones(own, stations.numpy()) + _AT_GATE)
        return torch.from_numpy((ahead - self._first_gate[own]) % self._gate_counts[own])

    def nearest_stations(self, track: Tensor, position: Tensor, low: Tensor, high: Tensor) -> Tensor:
        """The station of the centreline point nearest to each position, searched between two stations only.

        The road may come close to itself, so the nearest point of the whole centreline can be on another stretch.

        Args:
            track: [B], int64.
            position: [B, 2], m.
            low: where to begin to search, [B], m.
            high: where to end, [B], m, at least `low`; may exceed the length by up to a lap.

        Returns:
            [B], float64, m, between `low` and `high`.
        """
        samples = torch.linspace(0, 1, _SEARCH_SAMPLES, dtype=torch.float64)
        stations = low.double()[:, None] + (high - low).double()[:, None] * samples
        _, points = self._points_at(track.repeat_interleave(_SEARCH_SAMPLES).numpy(), stations.flatten().numpy())
        away = torch.from_numpy(points[:, 0]).view(*stations.shape, 2) - position.double()[:, None]
        nearest = torch.linalg.vector_norm(away, dim=-1).argmin(dim=1)
        return stations.gather(1, nearest[:, None])[:, 0]

    def _milestones(self, track: np.ndarray, stations: np.ndarray) -> np.ndarray:
        return self._bases[track] + stations.astype(np.float64, copy=False) % self._lengths[track]

    def _points_at(self, track: np.ndarray, stations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The segment [B], and there the points of the centreline, the left and the right wall, [B, 3, 2], float64."""
        milestones = self._milestones(track, stations)
        segment = self._segment_begin.searchsorted(milestones, side="right") - 1
        segment = np.minimum(np.maximum(segment, 0), self._last_segment[track])
        begin, end = self._segment_begin[segment], self._segment_end[segment]
        share = ((milestones - begin) / (end - begin))[:, None, None]
        return segment, self._begin[segment] + share * self._edge[segment]
