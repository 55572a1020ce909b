"""Where lines of the road cross: bridges, where the road crosses itself, and folds, where a wall crosses itself.

Lines are looked at a block at a time, so that a track drawn to have billions of crossings costs little.

In a bend tighter than the road's half width the points of the inner wall, which stand beside those of the centreline,
run backwards for a while, and the wall crosses itself before and after: a fold. What lies between is on no edge of the
road, and is cut.

Shapes: `P` points, `K` pairs. A *station* is a distance along the centreline from the start line, m.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from shapely import LinearRing, LineString, STRtree

from carrl.errors import TrackError

MOST_CROSSINGS = 2**16
"""Of the walls or the centreline of one track with themselves; a real one with a bridge has some ten."""
MOST_EXAMINED = 2**22
"""Pairs of lines whose bounding boxes meet, of which two seconds' work is made."""
_BLOCK = 64
LONGEST_FOLD = 8.0
"""A fold spans at most this many half widths of the centreline; where a wall crosses itself after a longer way, two
stretches of road overlap. A bend of 150 degrees without any radius spans 7.5."""
_MOST_ROUNDS = 8

Wanted = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Which pairs of indices [K] and [K] count, [K] bool."""


def find_crossings(lines: np.ndarray, others: np.ndarray, wanted: Wanted, most: int = MOST_CROSSINGS) -> np.ndarray:
    """Pairs of indices of lines and of others that meet and are wanted, [K, 2]; `most` and one if there are more.

    Args:
        lines: shapely geometries.
        others: likewise; may be the same.
        wanted: which pairs count.
        most: how many of them to find before the search ends.

    Raises:
        TrackError: so many lines are near each other that to look at all pairs would take long.
    """
    tree, found, count, examined = STRtree(others), [np.zeros((0, 2), dtype=np.int64)], 0, 0
    for begin in range(0, len(lines), _BLOCK):
        one, other = tree.query(lines[begin : begin + _BLOCK])
        examined += len(one)
        if examined > MOST_EXAMINED:
            raise TrackError(
                f"more than {MOST_EXAMINED:,} pairs of a track's walls and gates are near each other; "
                "make it narrower or shorter"
            )
        one = one + begin
        keep = wanted(one, other)
        one, other = one[keep], other[keep]
        keep = shapely.intersects(lines[one], others[other])
        found.append(np.stack([one[keep], other[keep]], axis=1)[: most + 1 - count])
        count += len(found[-1])
        if count > most:
            break
    return np.concatenate(found)


def segments_of(points: np.ndarray) -> np.ndarray:
    """The segments of the closed line through points [P, 2], [P] shapely lines."""
    return np.asarray(shapely.linestrings(np.stack([points, np.roll(points, -1, axis=0)], axis=1)))


def check_crossings(crossings: np.ndarray, most: int = MOST_CROSSINGS) -> None:
    """Raises TrackError where the pairs [K, 2] are so many that the search for them was ended."""
    if len(crossings) > most:
        raise TrackError(f"a track crosses itself more than {most:,} times; draw a road that does not run over itself")


def cut_folds(wall: np.ndarray, centreline: np.ndarray) -> np.ndarray:
    """The wall with the points of each fold moved to where the fold's ends cross; the same array without folds.

    Args:
        wall: of one side, a point beside each point of the centreline, [P, 2], m.
        centreline: [P, 2], m.

    Returns:
        [P, 2], m. The points of a cut fold coincide.

    Raises:
        TrackError: the wall crosses itself tens of thousands of times.
    """
    for _ in range(_MOST_ROUNDS):  # Cutting one fold can uncover another; two rounds are rare.
        folds = [] if LinearRing(wall).is_simple else _find_folds(wall, centreline)
        if not folds:
            return wall
        wall = wall.copy()
        for inside, crossing in folds:
            wall[inside] = crossing
    return wall


def count_folds(wall: np.ndarray) -> int:
    """How many folds of this wall [P, 2] were cut: how often neighbouring points coincide, one run counted once."""
    repeats = (wall == np.roll(wall, -1, axis=0)).all(axis=1)
    return int((repeats & ~np.roll(repeats, 1)).sum())


def _find_folds(wall: np.ndarray, centreline: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Indices of the points inside each fold and the point where its ends cross; no two folds share a point."""
    count = len(wall)
    steps = np.linalg.norm(np.roll(centreline, -1, axis=0) - centreline, axis=1)
    reach = LONGEST_FOLD * np.linalg.norm(wall - centreline, axis=1)
    folds, taken = [], np.zeros(count, dtype=bool)
    for first, points in _loops(wall, steps):
        inside = (first + 1 + np.arange(points)) % count
        last = inside[-1]
        if taken[inside].any() or steps[inside[:-1]].sum() > reach[inside].max():
            continue
        if not LineString(centreline[(first + np.arange(points + 2)) % count]).is_simple:
            continue  # The road itself makes a loop.
        crossing = _crossing(wall[first], wall[inside[0]], wall[last], wall[(last + 1) % count])
        if crossing is not None:
            folds.append((inside, crossing))
            taken[inside] = True
    return folds


def _loops(wall: np.ndarray, steps: np.ndarray) -> list[tuple[int, int]]:
    """For each crossing of the wall with itself: the wall before its shorter loop, and how many points the loop has.

    Longer loops come first, since a fold often crosses itself inside, too.
    """
    count = len(wall)
    ends = np.roll(wall, -1, axis=0)
    walls = segments_of(wall)

    along = np.concatenate([[0], np.linalg.norm(ends - wall, axis=1).cumsum()])

    def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        # Walls of a fold that was cut meet where they end, with nothing but walls without length between them.
        between, around = along[other] - along[one + 1], along[-1] - along[other + 1] + along[one]
        return np.asarray((other - one > 1) & (between > 0) & (around > 0))

    crossings = find_crossings(walls, walls, apart)
    check_crossings(crossings)
    stations = np.concatenate([[0], steps.cumsum()])
    loops = []
    for low, high in crossings.tolist():
        around = stations[high] - stations[low] > stations[-1] / 2
        loops.append((high, low + count - high) if around else (low, high - low))
    return sorted(loops, key=lambda loop: -loop[1])


def _crossing(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray | None:
    """Where the segments a-b and c-d cross; None where they run along each other."""
    along, across = b - a, d - c
    area = along[0] * across[1] - along[1] * across[0]
    if area == 0:
        return None
    gap = c - a
    return np.asarray(a + (gap[0] * across[1] - gap[1] * across[0]) / area * along)


Stretch = tuple[float, float]
"""Begin and end of a stretch of road, stations in m: begin in [0, length), end > begin, maybe beyond `length`."""

MOST_ROAD_CROSSINGS = 2**10
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
        segments, segments, lambda low, high: (high - low > 1) & (high - low < count - 1), MOST_ROAD_CROSSINGS
    )
    check_crossings(crossings, MOST_ROAD_CROSSINGS)
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
