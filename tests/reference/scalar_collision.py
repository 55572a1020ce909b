"""An independent, slow distance between a path and walls, in plain Python floats.

Source: Christer Ericson, Real-Time Collision Detection (2005), 5.1.9: the closest points of two segments are found by
minimising over one parameter, clamping it, and minimising over the other. No crossing test and no choice among end
points, on which `carrl.sim.geometry` rests.
"""

import math
from collections.abc import Iterable

Point = tuple[float, float]


def path_distance(begin: Point, end: Point, walls: Iterable[tuple[Point, Point]]) -> float:
    """The least distance between the straight path and any wall."""
    return min(segment_distance(begin, end, first, last) for first, last in walls)


def segment_distance(begin1: Point, end1: Point, begin2: Point, end2: Point) -> float:
    """The least distance between two segments, each of which may be a single point."""
    ux, uy = end1[0] - begin1[0], end1[1] - begin1[1]
    vx, vy = end2[0] - begin2[0], end2[1] - begin2[1]
    wx, wy = begin1[0] - begin2[0], begin1[1] - begin2[1]
    uu, vv, uv = ux * ux + uy * uy, vx * vx + vy * vy, ux * vx + uy * vy
    uw, vw = ux * wx + uy * wy, vx * wx + vy * wy
    determinant = uu * vv - uv * uv
    share1 = _clamp((uv * vw - uw * vv) / determinant) if determinant > 1e-12 * uu * vv else 0.0
    share2 = (uv * share1 + vw) / vv if vv > 0 else 0.0
    if not 0 <= share2 <= 1 or vv == 0:
        share2 = _clamp(share2)
        share1 = _clamp((uv * share2 - uw) / uu) if uu > 0 else 0.0
    return math.hypot(wx + share1 * ux - share2 * vx, wy + share1 * uy - share2 * vy)


def _clamp(share: float) -> float:
    return min(max(share, 0.0), 1.0)
