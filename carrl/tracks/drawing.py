"""Closed lines drawn by hand, as rounded polygons or smooth curves, and the tracks that come with CarRL.

Shapes: `P` points of the line, `N` corners or points that a person gave.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from shapely import LinearRing, Point, Polygon
from shapely.geometry.polygon import orient

from carrl.errors import TrackError
from carrl.tracks.centreline import Centreline

_SAMPLES_PER_SPAN = 32


def rounded_polygon(corners: np.ndarray, corner_radius: float, point_spacing: float) -> np.ndarray | None:
    """The polygon's outline with rounded corners as evenly spaced points, in the order of the corners.

    Args:
        corners: [N, 2], m; the outline may not cross itself.
        corner_radius: least radius of the line, m, in turns to either side.
        point_spacing: about how far the points stand apart, m.

    Returns:
        [P, 2], m, starting half-way between the first two corners; None where corners of that radius do not fit.
    """
    arcs = {"quad_segs": 64}
    # Shrinking by the radius and growing back rounds the corners to the left, and the reverse those to the right.
    rounded = (
        Polygon(corners).buffer(-corner_radius, **arcs).buffer(2 * corner_radius, **arcs).buffer(-corner_radius, **arcs)
    )
    if rounded.geom_type != "Polygon" or rounded.is_empty or rounded.interiors:
        return None
    ring = orient(rounded, sign=1.0 if LinearRing(corners).is_ccw else -1.0).exterior
    start = ring.project(Point(np.mean(corners[:2], axis=0)))
    count = max(3, round(ring.length / point_spacing))
    stations = (start + np.arange(count) * ring.length / count) % ring.length
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(ring, stations)))


def smooth_curve(points: np.ndarray, point_spacing: float) -> np.ndarray:
    """A closed curve of continuous curvature through all points, evenly resampled from the first point on.

    Source: the periodic cubic spline, with the centripetal knots of Lee (1989), which keep it near the points.

    Args:
        points: x and y, m, and any other values to be carried along, [N, 2 + ...]; neighbours differ in place.
        point_spacing: about how far the points of the curve stand apart, m.

    Returns:
        [P, 2 + ...].
    """
    from scipy.interpolate import CubicSpline  # Here, since it takes a quarter of a second to import.

    closed = np.vstack([points, points[:1]])
    steps = np.sqrt(np.linalg.norm(np.diff(closed[:, :2], axis=0), axis=1))
    knots = np.concatenate([[0], steps.cumsum()])
    shares = np.linspace(0, 1, _SAMPLES_PER_SPAN, endpoint=False)
    at = (knots[:-1, None] + steps[:, None] * shares).ravel()
    return _resample(CubicSpline(knots, closed, bc_type="periodic")(at), point_spacing)


def _resample(samples: np.ndarray, point_spacing: float) -> np.ndarray:
    """Evenly spaced points of the closed line through the samples."""
    closed = np.vstack([samples, samples[:1]])
    stations = np.concatenate([[0], np.linalg.norm(np.diff(closed[:, :2], axis=0), axis=1).cumsum()])
    count = max(3, round(stations[-1] / point_spacing))
    even = np.arange(count) * stations[-1] / count
    return np.stack([np.interp(even, stations, column) for column in closed.T], axis=1)


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
"""The built-in tracks, easiest first."""
