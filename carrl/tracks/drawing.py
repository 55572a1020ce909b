"""Closed lines drawn by hand: a polygon whose corners are rounded, or a smooth curve through points.

Shapes: `P` points of the line, `N` corners or points that a person gave.
"""

import numpy as np
import shapely
from shapely import LinearRing, Point, Polygon
from shapely.geometry.polygon import orient

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
