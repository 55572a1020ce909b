"""Roads in another size, driven the other way round or from another start, and tracks as centrelines with widths.

Shapes: `P` points of the centreline, `N` points of a line.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree
from shapely import LinearRing, distance, points
from torch import Tensor

from carrl.errors import TrackError, shown
from carrl.tracks.bridges import cut_folds
from carrl.tracks.centreline import (
    MAX_COORDINATE,
    MIN_POINTS,
    MIN_STEP,
    MITRED,
    Centreline,
    Road,
    normals,
    turns,
    without_repeats,
)
from carrl.tracks.rings import arc_lengths, cast, resampled, signed_area

if TYPE_CHECKING:
    from carrl.tracks.track import Track

SCALES = 1e-3, 1e3
DIRECTIONS = ("clockwise", "counterclockwise")
_LEAST_TURN = 0.01
"""Area within a road that is driven one way round, in those of a circle as long; it is 0 of an even figure eight."""
_EXACT = 1e-3
"""Walls that the offset centreline meets this closely, m, need no other points."""
_STEPS_ACROSS = 40
"""Points of a centreline in the width of the road, where its walls do not stand square to it."""
_WAYS = ((0.1, 2.0), (0.3, 2.0), (0.3, 6.0))
"""Over how much of the road's width a centreline is smoothed, and how far its walls are looked for; all are tried until
one is close, for what draws one hairpin well spoils another."""
_CLOSE = 0.02
"""How close that is, in widths of the road."""
_MOST_POINTS = 5000
_SAMPLES = 4000


def adjusted(
    name: str, road: Road, scale: float = 1.0, direction: str | None = None, start_at: Sequence[float] | None = None
) -> Road:
    """A road in another size, driven the other way round, or from another start.

    Args:
        name: of its track, for messages.
        road: any.
        scale: how many times as large; points that come too close to each other are left out.
        direction: clockwise or counterclockwise, from the same start; None for that of the road.
        start_at: x and y, m, after scaling: the start is the nearest point of the centreline; None as in the road.

    Raises:
        TrackError: one of them has no such value, or the road gets too large or too small.
    """
    try:
        road = _scaled(road, scale)
        road = road if direction is None else _directed(road, direction)
        return road if start_at is None else _started_at(road, start_at)
    except TrackError as error:
        raise TrackError(f"track '{name}': {error}") from None


def _scaled(road: Road, scale: float) -> Road:
    if not _is_number(scale) or not SCALES[0] <= scale <= SCALES[1]:
        raise TrackError(f"scale is {shown(scale)}; it must be a number from {SCALES[0]:g} to {SCALES[1]:g}")
    if scale == 1:
        return road
    table, repeats = without_repeats(np.concatenate([road.centre, road.left, road.right], axis=1) * scale)
    if len(table) < MIN_POINTS or not (np.abs(table[:, :2]) <= MAX_COORDINATE).all():
        raise TrackError(f"at scale {scale:g} it is too small, or reaches further than {MAX_COORDINATE:.0f} m")
    return replace(
        road,
        centre=table[:, :2],
        left=table[:, 2:4],
        right=table[:, 4:],
        repeats=road.repeats + repeats,
        gate_spacing=None if road.gate_spacing is None else road.gate_spacing * scale,
        reference=None if road.reference is None else road.reference * scale,
    )


def _directed(road: Road, direction: str) -> Road:
    if direction not in DIRECTIONS:
        raise TrackError(f"direction is {shown(direction)}; it must be {' or '.join(DIRECTIONS)}")
    area, round_area = signed_area(road.centre), arc_lengths(road.centre)[-1] ** 2 / (4 * math.pi)
    if abs(area) < _LEAST_TURN * round_area:
        raise TrackError(
            f"direction is {direction}, but it goes as far around to one side as to the other; leave it out"
        )
    is_clockwise = area < 0
    if is_clockwise == (direction == DIRECTIONS[0]):
        return road
    centre, left, right = (np.roll(line[::-1], 1, axis=0) for line in (road.centre, road.right, road.left))
    reference = None if road.reference is None else road.reference[::-1]
    return replace(road, centre=centre, left=left, right=right, reference=reference)


def _started_at(road: Road, place: Sequence[float]) -> Road:
    if not (isinstance(place, Sequence) and len(place) == 2 and all(map(_is_number, place))):
        raise TrackError(f"start_at is {shown(place)}; it must be [x, y], m")
    lines = np.stack([road.centre, road.left, road.right], axis=1)
    low, high = lines.min(axis=(0, 1)), lines.max(axis=(0, 1))
    margin = (high - low) / 2
    if not ((low - margin <= place) & (place <= high + margin)).all():
        raise TrackError(
            f"start_at is {shown(list(place))}, far beyond the road, which is from [{low[0]:.6g}, {low[1]:.6g}] to "
            f"[{high[0]:.6g}, {high[1]:.6g}] m, after scaling"
        )
    way = np.roll(lines, -1, axis=0) - lines
    away = np.asarray(place, dtype=np.float64) - lines[:, 0]
    share = ((away * way[:, 0]).sum(axis=1) / (way[:, 0] ** 2).sum(axis=1)).clip(0, 1)
    index = int(np.linalg.norm(away - share[:, None] * way[:, 0], axis=1).argmin())
    start = lines[index] + share[index] * way[index]
    lines, _ = without_repeats(np.concatenate([start[None], np.roll(lines, -index - 1, axis=0)]).reshape(-1, 6))
    return replace(road, centre=lines[:, :2], left=lines[:, 2:4], right=lines[:, 4:])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def as_centreline(track: "Track") -> Centreline:
    """The track as a centreline with widths, whose walls are those of the track as nearly as such walls can be."""
    middle, left, right = (_array(line) for line in (track.centreline, track.left_wall, track.right_wall))
    turn = np.abs(turns(middle))
    mitre = np.where((turn > MITRED[0]) & (turn < MITRED[1]), np.cos(turn / 2), 1)
    widths = ((mitre * np.linalg.norm(side - middle, axis=1)).clip(MIN_STEP) for side in (right, left))
    best = Centreline(middle, *widths)
    least = _off(best, left, right)
    across = float(np.median(np.linalg.norm(left - right, axis=1)))
    step = max(across / _STEPS_ACROSS, arc_lengths(middle)[-1] / _MOST_POINTS, 2 * MIN_STEP)
    even = resampled(middle, step)
    for smoothing, reach in _WAYS:
        if least < _EXACT or (best.points is not middle and least < _CLOSE * across):
            break
        # Smooth, so that its normals sweep the outside of each corner.
        line = ndimage.gaussian_filter1d(even, smoothing * across / step, axis=0, mode="wrap")
        to_left, to_right = (_widths(line, sign, wall, reach) for sign, wall in ((1, left), (-1, right)))
        candidate = Centreline(line, to_right, to_left)
        off = _off(candidate, left, right)
        if off < least:
            best, least = candidate, off
    return best


def _off(line: Centreline, left: np.ndarray, right: np.ndarray) -> float:
    """How far the walls beside a centreline are from others, [P, 2] each, m."""
    return max(
        _apart(cut_folds(wall, line.points), true) for wall, true in zip(line.walls(), (left, right), strict=True)
    )


def _widths(middle: np.ndarray, sign: int, wall: np.ndarray, reach: float) -> np.ndarray:
    """How far a wall is from the middle [P, 2], square to it, [P], m.

    Args:
        middle: [P, 2], m.
        sign: 1 for the wall on the left, -1 for that on the right.
        wall: [N, 2], m.
        reach: how far to look for it, in distances of its nearest point; between other places if it is not there.
    """
    nearest, index = KDTree(resampled(wall, arc_lengths(middle)[1])).query(middle)[0], np.arange(len(middle))
    length = reach * nearest + MIN_STEP
    share = cast(middle, sign * normals(middle) * length[:, None], wall)[0]
    found = np.flatnonzero(np.isfinite(share))
    if len(found) == 0:
        return np.asarray(nearest.clip(MIN_STEP))
    return np.interp(index, found, (share * length)[found], period=len(index)).clip(MIN_STEP)


def walls_apart(one: "Track", other: "Track") -> float:
    """The largest distance from a place on a wall of one track to the nearest wall on that side of the other, m."""
    pairs = ((one.left_wall, other.left_wall), (one.right_wall, other.right_wall))
    return max(_apart(_array(first), _array(second)) for first, second in pairs)


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """The Hausdorff distance of two closed lines [N, 2], at places a small step apart."""
    largest = 0.0
    for first, second in ((one, other), (other, one)):
        places = np.concatenate([first, resampled(first, arc_lengths(first)[-1] / _SAMPLES)])
        largest = max(largest, float(distance(points(places), LinearRing(second)).max()))
    return largest


def _array(line: Tensor) -> np.ndarray:
    return line.double().numpy()
