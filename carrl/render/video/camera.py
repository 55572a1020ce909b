"""What part of the track a frame shows: all of it where that is small, or else the surroundings of the car.

Shapes: `N` points. World coordinates are in metres, picture coordinates in pixels with y down.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from carrl.log.scene import Floats, Scene, TrackShape

LEAST_SCALE = 5.0
"""Of a track that is shown as a whole, pixels per metre: with less, car and rays are too small to follow."""
CLOSEST_SCALE = 11.0
"""When the camera follows the car, at most, pixels per metre."""
RANGES_SEEN = 2.4
"""When the camera follows the car, it sees at least so many ranges of the sensor from top to bottom."""


@dataclass(frozen=True)
class Area:
    """A rectangle of the picture, pixels."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Of the rectangle."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Of the rectangle."""
        return self.top + self.height

    @property
    def middle(self) -> tuple[float, float]:
        """Of the rectangle."""
        return self.left + self.width / 2, self.top + self.height / 2

    def inset(self, margin: float) -> "Area":
        """The rectangle without a margin on all four sides."""
        return Area(self.left + margin, self.top + margin, self.width - 2 * margin, self.height - 2 * margin)


@dataclass(frozen=True, eq=False)
class View:
    """A place of the world in an area of the picture.

    Attributes:
        area: of the picture.
        centre: what the middle of the area shows, [2], m.
        scale: pixels per metre.
    """

    area: Area
    centre: ArrayLike
    scale: float

    def pixels(self, points: ArrayLike) -> Floats:
        """Where points of the world [..., 2] appear in the picture, [..., 2]."""
        return np.asarray(self.area.middle + (np.asarray(points) - self.centre) * (self.scale, -self.scale))


def whole(track: TrackShape, area: Area) -> View:
    """The track as large as it fits."""
    left, bottom, right, top = track.bounds
    scale = min(area.width / (right - left), area.height / (top - bottom))
    return View(area, np.array([left + right, bottom + top]) / 2, scale)


def follow_scale(scene: Scene, area: Area) -> float:
    """Pixels per metre for a camera that follows the car."""
    return min(CLOSEST_SCALE, area.height / (RANGES_SEEN * scene.sensor_range))
