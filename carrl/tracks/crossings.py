"""Which lines of many meet, and the small loops that a wall makes where it crosses itself in a tight bend.

Lines are looked at a block at a time, so that a track drawn to have billions of crossings costs little.

In a bend tighter than the road's half width the points of the inner wall, which stand beside those of the centreline,
run backwards for a while, and the wall crosses itself before and after: a fold. What lies between is on no edge of the
road, and is cut.

Shapes: `K` pairs, `P` points.
"""

from collections.abc import Callable

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
