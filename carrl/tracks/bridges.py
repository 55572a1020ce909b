"""Finds the places where the road crosses itself and tells apart the two stretches of road that meet there.

Shapes: `P` points, `K` pairs. A *station* is a distance along the centreline from the start line, m.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from shapely import LinearRing, LineString, STRtree

from carrl.errors import TrackError
from carrl.tracks.crossings import check_crossings, find_crossings, segments_of

Stretch = tuple[float, float]
"""Begin and end of a stretch of road, stations in m: begin in [0, length), end > begin, maybe beyond `length`."""

MOST_CROSSINGS = 2**10
"""Of the centreline with itself; each bridge has one, or a few where points of it lie on each other."""
_MOST_OVERLAPS = 2**16
"""Of pieces of road that meet at one bridge; a real one has some hundred."""
MARGIN = 1.0
"""How far each stretch reaches beyond the last of its walls that touches the other's road, m."""


@dataclass(frozen=True)
class Bridge:
    """Two stretches of one road, each just long enough to hold all its walls that touch the other's road.

    Only the walls of its own stretch are in a car's way there, so which of the two is the upper one matters to pictures
    alone. In a file it is the one driven later in a lap.
    """

    over: Stretch
    under: Stretch

    def reversed(self, length: float) -> "Bridge":
        """The same bridge of the same road, `length` m long, driven the other way."""
        return Bridge(over=_reversed(self.over, length), under=_reversed(self.under, length))


def _reversed(stretch: Stretch, length: float) -> Stretch:
    begin = (length - stretch[1]) % length
    return begin, begin + stretch[1] - stretch[0]


def on_stretch(stations: np.ndarray, stretch: Stretch, length: float) -> np.ndarray:
    """Whether stations [K], m, of a road `length` m long lie on the stretch, [K]."""
    begin, end = stretch
    return np.asarray((stations - begin) % length <= end - begin)


def on_two_decks(bridges: Sequence[Bridge], length: float, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether of each pair of stations [K], m, one lies over and the other under the same bridge, [K]."""
    apart = np.zeros(len(one), dtype=bool)
    for bridge in bridges:
        for first, second in ((one, other), (other, one)):
            apart |= on_stretch(first, bridge.over, length) & on_stretch(second, bridge.under, length)
    return apart


def check_road(centreline: np.ndarray) -> None:
    """Raises TrackError for a road [P, 2], m, that crosses itself too often to look for its folds and bridges."""
    if not LinearRing(centreline).is_simple:
        _crossing_segments(centreline)


def find_bridges(name: str, centreline: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[Bridge, ...]:
    """The bridges of a road, by the station of their lower stretch.

    Args:
        name: of the track, for messages.
        centreline: [P, 2], m.
        left: the left wall at each of its points, [P, 2], m.
        right: the right wall, [P, 2], m.

    Raises:
        TrackError: the centreline runs along itself, or the two stretches at a crossing cannot be told apart.
    """
    if LinearRing(centreline).is_simple:
        return ()
    stations = np.concatenate([[0], np.linalg.norm(np.roll(centreline, -1, axis=0) - centreline, axis=1).cumsum()])
    crossings = _crossing_segments(centreline)
    if not crossings:
        raise TrackError(f"track '{name}': the centreline crosses itself by turning back onto itself; remove the spike")
    quads = _quads(centreline, left, right)
    bridges: list[Bridge] = []
    explained: set[tuple[int, int]] = set()
    for crossing in crossings:
        if crossing not in explained:
            place = f"track '{name}': the centreline crosses itself at {stations[crossing[0]]:.0f} m"
            meeting = _meeting_quads(crossing, quads, place)
            explained |= {(min(pair), max(pair)) for pair in np.array(list(meeting)) % len(centreline)}
            bridges.append(_bridge(meeting, centreline, stations, place))
    _check_apart(name, bridges, float(stations[-1]))
    return tuple(bridges)


def _crossing_segments(centreline: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of segments, lower index first, that meet although they are not neighbours."""
    count = len(centreline)
    segments = segments_of(centreline)
    crossings = find_crossings(
        segments, segments, lambda low, high: (high - low > 1) & (high - low < count - 1), MOST_CROSSINGS
    )
    check_crossings(crossings, MOST_CROSSINGS)
    return sorted(map(tuple, crossings.tolist()))


def _quads(centreline: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The road about each segment of the centreline, [P] polygons; hulls, since a fold twists them."""
    sides = [left, centreline, right]
    corners = np.stack([*sides, *(np.roll(side, -1, axis=0) for side in sides)], axis=1)
    return np.asarray(shapely.convex_hull(shapely.multipoints(corners)))


def _meeting_quads(crossing: tuple[int, int], quads: np.ndarray, place: str) -> set[tuple[int, int]]:
    """All pairs of quads that overlap in one piece with those of a crossing, lower index first; not taken modulo P.

    Raises:
        TrackError: the piece reaches a segment and its neighbour, so it is not two stretches.
    """
    count, tree = len(quads), STRtree(quads)
    overlapping: dict[int, set[int]] = {}
    found, frontier, overlaps = {crossing}, [crossing], 0
    while frontier:
        one, other = frontier.pop()
        too_many = len(found) > 4 * count or overlaps > _MOST_OVERLAPS
        if (other - one) % count in (0, 1, count - 1) or too_many:
            raise TrackError(
                f"{place}, where its two stretches of road run into each other; "
                "a bridge needs two stretches that part on both sides of it"
            )
        for pair in ((one + i, other + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            first, second = pair[0] % count, pair[1] % count
            if first not in overlapping:
                overlapping[first] = set(tree.query(quads[first], predicate="intersects").tolist())
                overlaps += len(overlapping[first])
            if pair not in found and second in overlapping[first]:
                found.add(pair)
                frontier.append(pair)
    return found


def _bridge(meeting: set[tuple[int, int]], centreline: np.ndarray, stations: np.ndarray, place: str) -> Bridge:
    """The bridge whose two stretches are the first and the second segments of these pairs.

    Raises:
        TrackError: the two meet more than once.
    """
    count, length = len(centreline), stations[-1]
    stretches, lines = [], []
    for segments in zip(*meeting, strict=True):
        first, last = min(segments), max(segments) + 1
        lines.append(LineString(centreline[np.arange(first, last + 1) % count]))
        ends = [stations[index % count] + index // count * length for index in (first, last)]
        begin = (ends[0] - MARGIN) % length
        stretches.append((float(begin), float(begin + ends[1] - ends[0] + 2 * MARGIN)))
    if lines[0].intersection(lines[1]).geom_type != "Point":
        raise TrackError(f"{place} more than once within one bridge; move the two stretches of road apart there")
    return Bridge(over=stretches[1], under=stretches[0])


def _check_apart(name: str, bridges: list[Bridge], length: float) -> None:
    """Raises TrackError where two stretches of bridges share a place, since a car there would be on two at once."""
    for one, other in combinations([stretch for bridge in bridges for stretch in (bridge.over, bridge.under)], 2):
        if (other[0] - one[0]) % length <= one[1] - one[0] or (one[0] - other[0]) % length <= other[1] - other[0]:
            raise TrackError(
                f"track '{name}': the road crosses itself at stretches that touch each other, {one[0]:.0f} to "
                f"{one[1]:.0f} m and {other[0]:.0f} to {other[1]:.0f} m; draw them further apart"
            )
