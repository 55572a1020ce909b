"""An independent, slow ray caster: one ray against one wall at a time, in plain Python floats."""

import math
from collections.abc import Iterable

Wall = tuple[tuple[float, float], tuple[float, float]]


def ray_distance(x: float, y: float, angle: float, walls: Iterable[Wall], max_range: float) -> float:
    """The distance to the first wall along the ray, or `max_range` where none is nearer.

    Each wall is turned into the frame in which the ray is the positive x axis. There it is met where its two ends lie
    on different sides of the axis, at the x of the point that divides it in the ratio of their heights.
    """
    cos, sin = math.cos(angle), math.sin(angle)
    nearest = max_range
    for (x1, y1), (x2, y2) in walls:
        height1 = cos * (y1 - y) - sin * (x1 - x)
        height2 = cos * (y2 - y) - sin * (x2 - x)
        if (height1 > 0) == (height2 > 0) or height1 == height2:
            continue
        along1 = cos * (x1 - x) + sin * (y1 - y)
        along2 = cos * (x2 - x) + sin * (y2 - y)
        distance = (along1 * height2 - along2 * height1) / (height2 - height1)
        if 0 <= distance < nearest:
            nearest = distance
    return nearest
