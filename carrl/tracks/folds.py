"""Cuts the small loops that a wall makes in a bend tighter than the road's half width.

There the points of the inner wall, which stand beside those of the centreline, run backwards for a while, and the wall
crosses itself before and after. What lies between is on no edge of the road.

Shapes: `P` points.
"""

import numpy as np
from shapely import LinearRing, LineString

from carrl.tracks.crossings import check_crossings, find_crossings, segments_of

LONGEST_FOLD = 8.0
"""A fold spans at most this many half widths of the centreline; where a wall crosses itself after a longer way, two
stretches of road overlap. A bend of 150 degrees without any radius spans 7.5."""
_MOST_ROUNDS = 8


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
