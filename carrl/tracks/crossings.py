"""Which lines of many meet, found a block at a time, so that a track drawn to have billions of crossings costs little.

Shapes: `K` pairs.
"""

from collections.abc import Callable

import numpy as np
import shapely
from shapely import STRtree

from carrl.errors import TrackError

MOST_CROSSINGS = 2**16
"""Of the walls or the centreline of one track with themselves; a real one with a bridge has some ten."""
MOST_EXAMINED = 2**22
"""Pairs of lines whose bounding boxes meet, of which two seconds' work is made."""
_BLOCK = 64

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
