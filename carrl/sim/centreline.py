"""A road given by its centreline and its widths.

Shapes: `P` points.
"""

from dataclasses import dataclass

import numpy as np

MIN_POINTS = 3
MOST_POINTS = 100_000
MIN_STEP = 0.01
"""Least distance between neighbouring points, m; together with MAX_COORDINATE it keeps them apart in float32."""
MAX_COORDINATE = 1e5


@dataclass(frozen=True)
class Centreline:
    """A closed line in driving order; the last point joins the first.

    Attributes:
        points: [P, 2], float64, m.
        width_right: from the centreline to the right wall, [P], m.
        width_left: from the centreline to the left wall, [P], m.
    """

    points: np.ndarray
    width_right: np.ndarray
    width_left: np.ndarray

    def walls(self) -> tuple[np.ndarray, np.ndarray]:
        """The left and the right wall, [P, 2] each, m: the points moved sideways by the widths."""
        tangent = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        to_left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return self.points + to_left * self.width_left[:, None], self.points - to_left * self.width_right[:, None]


def drop_closing_point(table: np.ndarray) -> np.ndarray:
    """The rows [P, ...], which begin with x and y, m, without a last one that repeats the first point, or nearly."""
    closes = len(table) > 1 and np.linalg.norm(table[0, :2] - table[-1, :2]) < MIN_STEP
    return table[:-1] if closes else table


def repeated_point(points: np.ndarray) -> int | None:
    """Index of a point [P, 2], m, that stands nearer than `MIN_STEP` to the next one; None where there is none."""
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    return int(steps.argmin()) if (steps < MIN_STEP).any() else None
