"""A road given by its centreline and its widths.

Shapes: `P` points.
"""

import math
from dataclasses import dataclass

import numpy as np

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
