"""Where things on the track are in a picture.

Shapes: `K` any points. Positions on the track are in metres, y upwards; positions in a picture are in pixels, y
downwards.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Size = tuple[int, int]


@dataclass(frozen=True)
class Projection:
    """From the track to a picture of this size with one position in its middle."""

    scale: float  # px per m
    middle: Floats  # [2], m
    size: Size  # px

    def __call__(self, points: Floats) -> Floats:
        """Positions [..., 2], m, in the picture, [..., 2], px."""
        return np.asarray((points - self.middle) * (self.scale, -self.scale) + np.array(self.size) / 2)

    def sees(self, low: Floats, high: Floats) -> NDArray[np.bool_]:
        """Which of the rectangles between these corners, [K, 2], m, may be in the picture, [K]."""
        reach = np.array(self.size) / 2 / self.scale
        return np.all((high >= self.middle - reach) & (low <= self.middle + reach), axis=-1)


def placed(shape: Floats, pose: Floats) -> Floats:
    """A shape with its nose to +x, [K, 2], m, at a pose [3]."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return np.asarray(shape @ np.array([[cosine, sine], [-sine, cosine]]) + pose[:2])
