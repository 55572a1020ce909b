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
    after = np.roll(points, -1, axis=0)
    step = np.sqrt(np.linalg.norm((after - points)[:, :2], axis=1))[:, None]
    bend = _second_derivatives(points, step)
    next_bend = np.roll(bend, -1, axis=0)
    passed = np.linspace(0, 1, _SAMPLES_PER_SPAN, endpoint=False) * step
    gone, left = passed.T[:, :, None], (step - passed).T[:, :, None]
    samples = (
        (left**3 * bend + gone**3 * next_bend) / (6 * step)
        + left * (points / step - bend * step / 6)
        + gone * (after / step - next_bend * step / 6)
    )
    return _resample(samples.transpose(1, 0, 2).reshape(-1, points.shape[1]), point_spacing)


def _second_derivatives(points: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Of the periodic cubic spline at its knots, [N, ...], which stand `step` [N, 1] before the next ones."""
    step_before = np.roll(step, 1, axis=0)
    slope = (np.roll(points, -1, axis=0) - points) / step
    jump = 6 * (slope - np.roll(slope, 1, axis=0))
    bend = np.zeros_like(points)
    for _ in range(60):  # Jacobi's method: the diagonal is twice the rest of its row, so each round halves the error.
        neighbours = step_before * np.roll(bend, 1, axis=0) + step * np.roll(bend, -1, axis=0)
        bend = (jump - neighbours) / (2 * (step_before + step))
    return bend


def _resample(samples: np.ndarray, point_spacing: float) -> np.ndarray:
    """Evenly spaced points of the closed line through the samples."""
    closed = np.vstack([samples, samples[:1]])
    stations = np.concatenate([[0], np.linalg.norm(np.diff(closed[:, :2], axis=0), axis=1).cumsum()])
    count = max(3, round(stations[-1] / point_spacing))
    even = np.arange(count) * stations[-1] / count
    return np.stack([np.interp(even, stations, column) for column in closed.T], axis=1)
