"""The tracks that come with CarRL, each drawn as a polygon whose corners are rounded.

Shapes: `P` points.
"""

from dataclasses import dataclass

import numpy as np

from carrl.errors import TrackError
from carrl.tracks.centreline import Centreline
from carrl.tracks.drawing import rounded_polygon


@dataclass(frozen=True)
class Drawing:
    """A circuit as a person would sketch it, driven counter-clockwise.

    Attributes:
        corners: of the polygon, m. The start line is half-way between the first two.
        corner_radius: least radius of the centreline, m, in turns to either side.
        width: from wall to wall, m.
        gate_count: evenly spaced, the last one on the start line.
        point_spacing: about how far the centreline's points stand apart, m.
    """

    corners: tuple[tuple[float, float], ...]
    corner_radius: float
    width: float
    gate_count: int
    point_spacing: float = 2.0

    def centreline(self) -> Centreline:
        """The rounded polygon as a centreline of evenly spaced points."""
        points = rounded_polygon(np.array(self.corners), self.corner_radius, self.point_spacing)
        if points is None:
            raise TrackError(f"a track has no room for corners of radius {self.corner_radius} m")
        half_width = np.full(len(points), self.width / 2)
        return Centreline(points=points, width_right=half_width, width_left=half_width)


DRAWINGS = {
    "oval": Drawing(
        corners=((-20, 0), (60, 0), (60, 40), (-20, 40)),
        corner_radius=16.0,
        width=10.0,
        gate_count=8,
    ),
    "paper": Drawing(
        corners=((-20, 0), (44, 0), (48, 28), (20, 24), (16, 36), (24, 54), (4, 64), (-16, 54), (-6, 30), (-24, 22)),
        corner_radius=9.0,
        width=8.0,
        gate_count=8,
    ),
    "serpentine": Drawing(
        corners=((-22, 0), (66, 0), (66, 17), (26, 17), (26, 34), (66, 34), (66, 54), (8, 54), (8, 22), (-22, 22)),
        corner_radius=7.9,
        width=6.5,
        gate_count=12,
    ),
}
