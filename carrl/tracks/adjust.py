"""Tracks in another size, driven the other way round or from another start, and as a centreline with widths.

Shapes: `P` points of the centreline, `N` points of a line.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import KDTree
from shapely import LinearRing, distance, points
from torch import Tensor

from carrl.errors import TrackError, shown
from carrl.tracks.bridges import Bridge
from carrl.tracks.centreline import MAX_COORDINATE, MIN_POINTS, MIN_STEP, Centreline, normals
from carrl.tracks.folds import cut_folds
from carrl.tracks.rings import arc_lengths, cast, resampled, signed_area

if TYPE_CHECKING:
    from carrl.tracks.track import Track

SCALES = 1e-3, 1e3
DIRECTIONS = ("clockwise", "counterclockwise")
_EXACT = 1e-3
"""Walls that the offset centreline meets this closely, m, need no other points."""
_STEPS_ACROSS = 40
"""Points of a centreline in the width of the road, where its walls do not stand square to it."""
_SMOOTHING = 0.1
"""Over how much of the road's width such a centreline is smoothed."""
_MOST_POINTS = 5000
_SAMPLES = 4000


def scaled(track: "Track", scale: float) -> "Track":
    """The track `scale` times as large, with as many gates; points that come too close to each other are left out.

    Raises:
        TrackError: the scale is no positive number, or the track gets too large or too small.
    """
    is_number = isinstance(scale, int | float) and not isinstance(scale, bool)
    if not is_number or not SCALES[0] <= scale <= SCALES[1]:
        raise TrackError(
            f"track '{track.name}': scale is {shown(scale)}; it must be a number from {SCALES[0]:g} to {SCALES[1]:g}"
        )
    if scale == 1:
        return track
    centre = track.centreline.double() * scale
    if centre.abs().max() > MAX_COORDINATE:
        raise TrackError(f"track '{track.name}': at scale {scale:g} it reaches beyond {MAX_COORDINATE:.0f} m")
    kept, last = [0], centre[0]
    for index in range(1, len(centre)):
        if torch.dist(centre[index], last) >= MIN_STEP:
            kept.append(index)
            last = centre[index]
    if len(kept) < MIN_POINTS:
        raise TrackError(f"track '{track.name}': at scale {scale:g} it is a point")
    return replace(
        track,
        centreline=centre[kept].float(),
        left_wall=(track.left_wall.double() * scale)[kept].float(),
        right_wall=(track.right_wall.double() * scale)[kept].float(),
        bridges=tuple(
            Bridge((each.over[0] * scale, each.over[1] * scale), (each.under[0] * scale, each.under[1] * scale))
            for each in track.bridges
        ),
        reference_line=None if track.reference_line is None else track.reference_line * scale,
    )


def directed(track: "Track", direction: str) -> "Track":
    """The track driven clockwise or counter-clockwise, from the same start.

    Raises:
        TrackError: the direction is neither.
    """
    if direction not in DIRECTIONS:
        raise TrackError(f"track '{track.name}': direction is {shown(direction)}; it must be {' or '.join(DIRECTIONS)}")
    is_clockwise = signed_area(track.centreline.double().numpy()) < 0
    return track if is_clockwise == (direction == DIRECTIONS[0]) else replace(track.reversed(), name=track.name)


def started_at(track: "Track", place: Sequence[float]) -> "Track":
    """The track with its start line at the point of its centreline that is nearest to a place, (x, y), m.

    Raises:
        TrackError: the place is no such pair.
    """
    if not (isinstance(place, Sequence) and len(place) == 2 and all(map(_is_coordinate, place))):
        raise TrackError(f"track '{track.name}': start_at is {shown(place)}; it must be [x, y], m")
    lines = torch.stack([track.centreline, track.left_wall, track.right_wall], dim=1).double()
    way = lines.roll(-1, 0) - lines
    to_place = torch.tensor([float(each) for each in place]).double() - lines[:, 0]
    squares = (way[:, 0] ** 2).sum(1)
    share = ((to_place * way[:, 0]).sum(1) / squares).clamp(0, 1)
    index = int(torch.linalg.vector_norm(to_place - share[:, None] * way[:, 0], dim=1).argmin())
    before = float(share[index] * squares[index].sqrt())
    station = float(torch.linalg.vector_norm(way[:index, 0], dim=1).sum()) + before
    turned = lines.roll(-index, 0)
    if before < MIN_STEP:
        station -= before
    elif float(squares[index].sqrt()) - before < MIN_STEP:
        station += float(squares[index].sqrt()) - before
        turned = lines.roll(-index - 1, 0)
    else:
        new = lines[index] + share[index] * way[index]
        turned = torch.cat([new[None], lines.roll(-index - 1, 0)])
    centre, left, right = turned.float().unbind(1)
    bridges = tuple(
        Bridge(*(_moved(stretch, station, track.length) for stretch in (each.over, each.under)))
        for each in track.bridges
    )
    return replace(track, centreline=centre, left_wall=left, right_wall=right, bridges=bridges)


def _moved(stretch: tuple[float, float], station: float, length: float) -> tuple[float, float]:
    begin = (stretch[0] - station) % length
    return begin, begin + stretch[1] - stretch[0]


def _is_coordinate(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_COORDINATE


def as_centreline(track: "Track") -> Centreline:
    """The track as a centreline with widths, whose walls are those of the track as nearly as such walls can be."""
    middle, left, right = (_array(line) for line in (track.centreline, track.left_wall, track.right_wall))
    widths = (np.linalg.norm(side - middle, axis=1).clip(MIN_STEP) for side in (right, left))
    simple = Centreline(middle, *widths)
    walls = [cut_folds(wall, middle) for wall in simple.walls()]
    if max(map(_apart, walls, (left, right))) < _EXACT:
        return simple
    across = float(np.median(np.linalg.norm(left - right, axis=1)))
    step = max(across / _STEPS_ACROSS, arc_lengths(middle)[-1] / _MOST_POINTS, 2 * MIN_STEP)
    # Smooth, so that its normals sweep the outside of each corner.
    middle = ndimage.gaussian_filter1d(resampled(middle, step), across * _SMOOTHING / step, axis=0, mode="wrap")
    to_left, to_right = _cast_widths(middle, left, right)
    return Centreline(middle, to_right, to_left)


def _cast_widths(middle: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far the left and the right wall are from the middle [P, 2], square to it, [P] each, m."""
    square, index = normals(middle), np.arange(len(middle))
    widths = []
    for wall, sign in ((left, 1), (right, -1)):
        nearest = KDTree(resampled(wall, arc_lengths(middle)[1])).query(middle)[0]
        reach = 2 * nearest + MIN_STEP
        share = cast(middle, sign * square * reach[:, None], wall)[0]
        found = np.flatnonzero(np.isfinite(share))
        width = share * reach if len(found) == 0 else np.interp(index, found, (share * reach)[found], period=len(index))
        widths.append(np.where(np.isfinite(width), width, nearest).clip(MIN_STEP))
    return widths[0], widths[1]


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
