"""The closed corridor of free space in a picture: the line in its middle, and its walls.

Shapes: `H`, `W` rows and columns of the picture, row 0 at the bottom; `N` points of a ring; `P` points of the
centreline. Lengths are in pixels; the middle of a pixel is at its column and row, plus one half each.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from scipy import ndimage, sparse
from scipy.spatial import KDTree, Voronoi
from shapely import Polygon

from carrl.tracks.centreline import normals
from carrl.tracks.drawing_file import smooth_curve
from carrl.tracks.rings import CorridorError, arc_lengths, cast, find_loop, pixel_of, point_at, resampled, signed_area

MOST_POINTS = 40_000
"""Of the centreline, about as many pixels."""
_MOST_SITES = 100_000
_SIDE_ARM = 4.0
"""A place this many half widths of the road from its middle lies in a side arm."""
_NEAR = 1.5
"""A wall is looked for square to the middle up to this many times as far as it is at its nearest."""
_MOST_PIECES = 8
_STEP = 0.5
"""About how far points of the centreline stand apart, pixels."""


@dataclass(frozen=True)
class Corridor:
    """A closed corridor, driven counter-clockwise.

    Attributes:
        centre: points in the middle between the walls, [P, 2], pixels.
        left: the inner wall beside each of them, [P, 2].
        right: the outer wall, [P, 2].
        islands: how many there are in the road, each of which was joined to the wall that it is nearer to.
    """

    centre: np.ndarray
    left: np.ndarray
    right: np.ndarray
    islands: int


def find_corridor(free: np.ndarray, occupancy: np.ndarray | None, middle: np.ndarray | None = None) -> Corridor:
    """Finds the one closed corridor of free space.

    Args:
        free: which pixels a car may be on, [H, W], bool.
        occupancy: 0 for free to 255 for occupied, [H, W], uint8, where grey pixels are partly covered; None where not.
        middle: the line in its middle, if it is known, [P, 2].

    Raises:
        CorridorError: there is none, it forks or has a side arm, there are several, or the known line is not in it.
    """
    try:
        return _corridor(*find_loop(free, occupancy), middle)
    except CorridorError as error:
        raise CorridorError(str(error), error.rings, error.place, free) from None


def _corridor(outer: np.ndarray, inner: np.ndarray, islands: list[np.ndarray], middle: np.ndarray | None) -> Corridor:
    left, right = _sides(inner, outer, islands)
    road = Polygon(outer, [inner])
    if middle is None:
        centre = _bisector(np.concatenate(left), np.concatenate(right))
        room = float(np.median(KDTree(inner).query(centre)[0]))
        middle = _smoothed(centre, room, road)
    else:
        middle = _known(middle, road)
    _refuse_side_arms(middle, [inner, outer])
    square = normals(middle)
    walls = [_wall(middle, outward, side) for outward, side in ((square, left), (-square, right))]
    centre, inner_wall, outer_wall = _finer(middle, walls)
    return Corridor(centre, inner_wall, outer_wall, len(islands))


def _sides(
    inner: np.ndarray, outer: np.ndarray, islands: list[np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The rings on the left and on the right of the road; an island is on the side that it is nearer to."""
    sides, left = ([inner], [outer]), list(islands)
    nearest = [[KDTree(side[0]).query(island)[0].min() for side in sides] for island in left]
    while left:
        index = min(range(len(left)), key=lambda each: min(nearest[each]))
        side, island = int(np.argmin(nearest.pop(index))), left.pop(index)
        sides[side].append(island)
        tree = KDTree(island)
        for each, other in zip(nearest, left, strict=True):
            each[side] = min(each[side], tree.query(other)[0].min())
    return sides


def _bisector(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The closed line, counter-clockwise, whose points are as far from one set of points [N, 2] as from the other.

    Source: the part of the medial axis between both; it follows from the Voronoi diagram of all points.

    Raises:
        CorridorError: the diagram cannot be followed once around.
    """
    gap = float(KDTree(left).query(right)[0].min())
    every = max(1, int(gap / 4))
    left, right = left[::every], right[::every]
    if len(left) + len(right) > _MOST_SITES:
        raise CorridorError(f"the walls have more than {_MOST_SITES:,} pixels; use a coarser resolution")
    sites = np.concatenate([left, right])
    is_left = np.arange(len(sites)) < len(left)
    shaken = sites + np.random.default_rng(0).uniform(-1e-3, 1e-3, sites.shape)  # no four of them on one circle
    diagram = Voronoi(shaken)
    ridges = np.array(diagram.ridge_vertices)[is_left[diagram.ridge_points].sum(axis=1) == 1]
    ridges = ridges[(ridges >= 0).all(axis=1)]
    names, ends = np.unique(ridges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    graph = sparse.coo_matrix((np.ones(len(ends)), ends.T), shape=(len(names), len(names)))
    _, part = sparse.csgraph.connected_components(graph, directed=False)
    largest = np.bincount(part).argmax()
    ends = ends[part[ends[:, 0]] == largest]
    if (np.bincount(ends.ravel())[ends] != 2).any():
        raise CorridorError("its middle cannot be told; use a finer resolution, or clean the picture of specks")
    line = diagram.vertices[names[_walk(ends)]]
    return line if signed_area(line) > 0 else line[::-1]


def _walk(ends: np.ndarray) -> np.ndarray:
    """The vertices of a closed line in order, from the pairs that it connects, each of which is in two of them."""
    beside: dict[int, list[int]] = {}
    for one, other in ends.tolist():
        beside.setdefault(one, []).append(other)
        beside.setdefault(other, []).append(one)
    first = int(ends[0, 0])
    line, at = [first], beside[first][0]
    while at != first:
        before = line[-1]
        line.append(at)
        one, other = beside[at]
        at = other if one == before else one
    return np.array(line)


def _smoothed(line: np.ndarray, room: float, road: Polygon) -> np.ndarray:
    """The line [P, 2] evenly resampled and smoothed over about half a road, less where it would leave the road.

    What smoothing once and twice again takes off in bends is given back, so that it does not cut them.
    """
    length = arc_lengths(line)[-1]
    if length > MOST_POINTS:
        raise CorridorError(f"its middle is {length:,.0f} pixels long; use a resolution of at most {MOST_POINTS:,}")
    even = resampled(line, _STEP)
    for share in (0.4, 0.2, 0.1):
        once, twice, thrice = _blurred(even, max(1.0, share * room / _STEP))
        smooth = 3 * once - 3 * twice + thrice
        if shapely.contains_xy(road, smooth[:, 0], smooth[:, 1]).all():
            return resampled(smooth, _STEP)
    return even


def _blurred(line: np.ndarray, sigma: float) -> list[np.ndarray]:
    """The closed line [P, 2] smoothed once, twice and thrice with a Gaussian of that many points."""
    lines = [line]
    for _ in range(3):
        lines.append(ndimage.gaussian_filter1d(lines[-1], sigma, axis=0, mode="wrap"))
    return lines[1:]


def _known(line: np.ndarray, road: Polygon) -> np.ndarray:
    """A line [P, 2] that is given as the middle of the road, evenly resampled, counter-clockwise.

    Raises:
        CorridorError: it leaves the road, or does not go around with it.
    """
    even = smooth_curve(line, _STEP)
    inside = shapely.contains_xy(road, even[:, 0], even[:, 1])
    if not inside.all():
        place = even[np.flatnonzero(~inside)[0]]
        rings = [np.array(ring.coords) for ring in (road.exterior, *road.interiors)]
        raise CorridorError(f"the given centreline leaves the road at {pixel_of(place)}", rings, place)
    if not Polygon(even).contains(Polygon(road.interiors[0]).representative_point()):
        raise CorridorError("the given centreline does not go around with the road")
    return even if signed_area(even) > 0 else even[::-1]


def _refuse_side_arms(middle: np.ndarray, rings: list[np.ndarray]) -> None:
    """Raises CorridorError where the corridor goes off to a place that the road does not pass."""
    tree = KDTree(middle)
    room = np.minimum(*(KDTree(ring).query(middle)[0] for ring in rings))
    for ring in rings:
        away, nearest = tree.query(ring)
        deepest = int((away / room[nearest]).argmax())
        if away[deepest] > _SIDE_ARM * max(room[nearest[deepest]], float(np.median(room))):
            raise CorridorError(
                f"the corridor branches: a side arm ends at {pixel_of(ring[deepest])}, {away[deepest]:.0f} pixels from "
                "the middle of the road; fill it",
                [*rings, middle],
                ring[deepest],
            )


class _Wall(NamedTuple):
    """A wall beside each point of the middle.

    Attributes:
        points: [P, 2].
        ring: of the corridor, on which most of them lie, [N, 2].
        places: where along it, going on around it, [P + 1], the last one a lap after the first.
        is_island: which of them lie on an island before it, [P], bool.
    """

    points: np.ndarray
    ring: np.ndarray
    places: np.ndarray
    is_island: np.ndarray


def _wall(middle: np.ndarray, outward: np.ndarray, own: list[np.ndarray]) -> _Wall:
    """The wall of a side beside the middle [P, 2], towards which unit vectors [P, 2] point.

    It is where rays square to the middle meet the first ring of the side. Where they meet it far off, since they pass
    beyond the tip of a hairpin or look into a bay, the wall goes on along the ring. Islands stand before it.
    """
    rays = outward * (_NEAR * KDTree(own[0]).query(middle)[0] + 1)[:, None]
    share, place = cast(middle, rays, own[0])
    places = _steady(place, np.isfinite(share), arc_lengths(own[0])[-1], len(middle))
    wall, is_island = point_at(own[0], places[:-1]), np.zeros(len(middle), dtype=bool)
    for island in own[1:]:
        nearer, place = cast(middle, rays, island)
        hits = nearer < share
        wall[hits] = point_at(island, place[hits])
        share, is_island = np.minimum(share, nearer), is_island | hits
    return _Wall(wall, own[0], places, is_island)


def _finer(middle: np.ndarray, walls: list[_Wall]) -> list[np.ndarray]:
    """The middle and the walls [P, 2] with more points where those of a wall are far apart, as outside of a bend."""
    gaps = [np.linalg.norm(np.roll(wall.points, -1, axis=0) - wall.points, axis=1) for wall in walls]
    pieces = np.ceil(np.maximum(*gaps) / (2 * _STEP)).clip(1, _MOST_PIECES).astype(int)
    index = np.repeat(np.arange(len(middle)), pieces)
    share = np.concatenate([np.arange(each) / each for each in pieces.tolist()])
    after = (index + 1) % len(middle)

    def between(points: np.ndarray) -> np.ndarray:
        return points[index] + share[:, None] * (points[after] - points[index])

    lines = [between(middle)]
    for wall in walls:
        places = wall.places[index] + share * (wall.places[index + 1] - wall.places[index])
        is_island = wall.is_island[index] | wall.is_island[after]
        lines.append(np.where(is_island[:, None], between(wall.points), point_at(wall.ring, places)))
    return lines


def _steady(places: np.ndarray, found: np.ndarray, length: float, count: int) -> np.ndarray:
    """Places along a ring that go on around it with the centreline, [P + 1], where normals cross before they meet it.

    Raises:
        CorridorError: they do not go around it once.
    """
    index = np.flatnonzero(found)
    if len(index) < count / 2:
        raise CorridorError("its walls are not beside its middle; clean the picture of specks")
    ahead = np.unwrap(places[index], period=length)
    closing = (places[index[0]] - ahead[-1] + length / 2) % length - length / 2
    turn = np.round((ahead[-1] - ahead[0] + closing) / length)
    if abs(turn) != 1:
        raise CorridorError("a wall does not go around with its middle; clean the picture of specks")
    lap = turn * length
    ahead = turn * np.interp(
        np.arange(-count, 2 * count),
        np.concatenate([index - count, index, index + count]),
        np.concatenate([ahead - lap, ahead, ahead + lap]),
    )
    forwards, backwards = np.maximum.accumulate(ahead), np.minimum.accumulate(ahead[::-1])[::-1]
    return np.asarray(turn * (forwards + backwards)[count : 2 * count + 1] / 2)
