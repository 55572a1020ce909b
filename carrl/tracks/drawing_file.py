"""Tracks drawn by hand, as rounded polygons or smooth curves: those that come with CarRL, and YAML files of others.

docs/tracks.md describes the files.

Shapes: `N` corners or points that a person gave, `P` points of the centreline.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely import LinearRing, Point, Polygon
from shapely.geometry.polygon import orient

from carrl.errors import TrackError, shown
from carrl.files import read_whole
from carrl.plain_yaml import parse_yaml
from carrl.tracks.centreline import (
    MAX_COORDINATE,
    MIN_POINTS,
    MIN_STEP,
    Centreline,
    Road,
    repeated_point,
    without_repeats,
)

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


@dataclass(frozen=True)
class Curve:
    """A circuit as a smooth curve through some points, driven in their order.

    Attributes:
        points: m. The start line is at the first one.
        width: from wall to wall, m.
        gate_count: evenly spaced, the last one on the start line.
        point_spacing: about how far the centreline's points stand apart, m.
    """

    points: tuple[tuple[float, float], ...]
    width: float
    gate_count: int
    point_spacing: float = 2.0

    def centreline(self) -> Centreline:
        """The curve as a centreline of evenly spaced points."""
        points = smooth_curve(np.array(self.points, dtype=np.float64), self.point_spacing)
        half_width = np.full(len(points), self.width / 2)
        return Centreline(points=points, width_right=half_width, width_left=half_width)


DRAWINGS: dict[str, Drawing | Curve] = {
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
    "grand_prix": Curve(
        points=(
            *((-40, 0), (80, 0), (200, 0), (310, 4), (375, 35), (395, 100), (355, 150), (285, 150), (225, 115)),
            *((165, 100), (115, 135), (115, 200), (165, 255), (245, 282), (320, 298), (348, 312), (350, 338)),
            *((322, 352), (240, 362), (150, 385), (80, 392), (10, 372), (-25, 335), (-22, 275), (-45, 225)),
            *((-95, 215), (-125, 250), (-135, 310), (-170, 355), (-235, 362), (-285, 325), (-285, 265)),
            *((-245, 215), (-228, 160), (-246, 132), (-285, 122), (-325, 105), (-338, 65), (-310, 22)),
            *((-250, 4), (-150, 0)),
        ),
        width=12.0,
        gate_count=91,
    ),
}
"""The built-in tracks: three for the paper's car, easiest first, and one for cars that race."""


MAX_YAML_BYTES = 2**18
"""About 10,000 points."""
MAX_LENGTH = 1e5
"""Of the closed line through the corners or points, m."""
MAX_CORNERS = 1000
POINT_SPACING = 2.0
"""How far the centreline's points stand apart at the most, m; tighter on smaller roads."""
MIN_GATES, MIN_GATE_SPACING = 3, 1.0
CORNER_KEYS = ("corners", "corner_radius", "width", "gates", "gate_spacing")
POINT_KEYS = ("points", "width", "smooth", "gates", "gate_spacing")


def read_drawing(path: Path) -> Road:
    """Reads a track given by `corners`, `corner_radius` and `width`, or by `points`.

    Raises:
        TrackError: the file is no such drawing.
    """
    return _Reader(path, _read_mapping(path)).drawing()


@dataclass(frozen=True)
class _Reader:
    """Takes checked values from a file's mapping; every error begins with the file's name."""

    path: Path
    values: dict[str, Any]

    def drawing(self) -> Road:
        """What the file draws."""
        forms = [key for key in ("corners", "points") if key in self.values]
        if len(forms) != 1:
            raise self._error(f"it has {' and '.join(forms) or 'neither'}; it must have one of corners and points")
        keys = CORNER_KEYS if forms == ["corners"] else POINT_KEYS
        unknown = [str(key)[:40] for key in self.values if key not in keys]
        if unknown:
            raise self._error(f"unknown key {', '.join(unknown)}; with {forms[0]} the keys are {', '.join(keys)}")
        if "gates" in self.values and "gate_spacing" in self.values:
            raise self._error("it has gates and gate_spacing; give one of the two")
        centreline = self._polygon() if forms == ["corners"] else self._line()
        if repeated_point(centreline.points) is not None:
            raise self._error(f"the road is too small to be drawn, or turns back on itself; enlarge its {forms[0]}")
        spacing = self._number("gate_spacing", least=MIN_GATE_SPACING) if "gate_spacing" in self.values else None
        return centreline.road(self._gates(LinearRing(centreline.points).length), spacing)

    def _polygon(self) -> Centreline:
        corners, repeats = self._table("corners", (2,), "[x, y]")
        if len(corners) > MAX_CORNERS:
            raise self._error(f"{len(corners)} corners; it may have at most {MAX_CORNERS}, so use points")
        radius, width = self._number("corner_radius"), self._number("width")
        if not Polygon(corners).is_valid:
            raise self._error("the corners' outline crosses itself; list them in driving order, or use points")
        points = rounded_polygon(corners, radius, self._spacing(corners, radius))
        if points is None:
            raise self._error(
                f"corner_radius is {radius:g} m, and the road between the corners has no room for it; make it smaller"
            )
        return Centreline(points, *_half_widths(np.full(len(points), width)), repeats)

    def _line(self) -> Centreline:
        smooth = self.values.get("smooth", True)
        if not isinstance(smooth, bool):
            raise self._error(f"smooth is {shown(smooth)}; it must be true or false")
        if "width" in self.values:
            table, repeats = self._table("points", (2,), "[x, y], since width is given")
            table = np.column_stack([table, np.full((len(table), 2), self._number("width") / 2)])
        else:
            form = "[x, y, width] or [x, y, right, left], or width must be given beside them"
            table, repeats = self._table("points", (3, 4), form)
            bad = np.argwhere(table[:, 2:] <= 0)
            if len(bad) > 0:
                row, column = bad[0].tolist()
                raise self._error(
                    f"points: row {row + 1}: width is {table[row, 2 + column]:g} m; widths must be positive"
                )
        if table.shape[1] == 3:
            table = np.column_stack([table[:, :2], table[:, 2] / 2, table[:, 2] / 2])
        spacing = self._spacing(table[:, :2], float((table[:, 2] + table[:, 3]).min()))
        if smooth:
            widths = table[:, 2:]
            table = smooth_curve(table, spacing)
            table[:, 2:] = table[:, 2:].clip(widths.min(axis=0), widths.max(axis=0))  # The curve may overshoot.
        return Centreline(table[:, :2], table[:, 2], table[:, 3], repeats)

    def _spacing(self, points: np.ndarray, detail: float) -> float:
        """Distance between the centreline's points that shows details of this size, m."""
        spacing = min(POINT_SPACING, detail / 3)
        length = LinearRing(points).length
        if length > min(MAX_LENGTH, MAX_LENGTH * spacing):
            raise self._error(
                f"the track is {length:,.0f} m long; at this width and radius it may have at most "
                f"{min(MAX_LENGTH, MAX_LENGTH * spacing):,.0f} m"
            )
        return max(spacing, 2 * MIN_STEP)

    def _table(self, key: str, columns: tuple[int, ...], form: str) -> tuple[np.ndarray, int]:
        """The rows of a list without those that repeat a point, and how many these were."""
        rows = self.values[key]
        if not isinstance(rows, list):
            raise self._error(f"{key} is {shown(rows)}; it must be a list with a row {form} for each")
        for number, row in enumerate(rows, start=1):
            if not isinstance(row, list) or len(row) not in columns or len(row) != len(rows[0]):
                raise self._error(f"{key}: row {number} is {shown(row)}; it must be {form}")
            for name, value in zip(("x", "y", "width", "left width"), row, strict=False):
                self._check_number(f"{key}: row {number}: {name}", value)
        table, repeats = without_repeats(np.array(rows, dtype=np.float64))
        if len(table) < MIN_POINTS:
            raise self._error(f"{len(table)} {key}; a closed road needs at least {MIN_POINTS}")
        return table, repeats

    def _number(self, key: str, least: float = MIN_STEP) -> float:
        if key not in self.values:
            raise self._error(f"the key {key} is missing")
        value = self.values[key]
        self._check_number(key, value)
        if value < least:
            raise self._error(f"{key} is {value:g} m; it must be at least {least:g} m")
        return float(value)

    def _check_number(self, name: str, value: Any) -> None:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not abs(value) <= MAX_COORDINATE:  # nan fails it, too
            raise self._error(
                f"{name} is {shown(value)}; it must be a number of metres of at most {MAX_COORDINATE:.0f}"
            )

    def _gates(self, length: float) -> int | None:
        gates, most = self.values.get("gates"), max(MIN_GATES, int(length / MIN_GATE_SPACING))
        if "gates" not in self.values:
            return None
        if isinstance(gates, bool) or not isinstance(gates, int) or not MIN_GATES <= gates <= most:
            raise self._error(f"gates is {shown(gates)}; it must be a whole number from {MIN_GATES} to {most}")
        return gates

    def _error(self, what: str) -> TrackError:
        return TrackError(f"track '{self.path.name}': {what}")


def _read_mapping(path: Path) -> dict[str, Any]:
    name = f"track '{path.name}'"
    try:
        values = parse_yaml(read_whole(path, MAX_YAML_BYTES, name, TrackError))
    except ValueError as error:
        raise TrackError(f"{name}: {error}") from None
    if values is None:
        raise TrackError(f"{name}: the file is empty; it must have one of corners and points")
    if not isinstance(values, dict):
        raise TrackError(f"{name}: this is {shown(values)}; it must be keys with values, such as 'width: 8'")
    return values


def _half_widths(widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return widths / 2, widths / 2
