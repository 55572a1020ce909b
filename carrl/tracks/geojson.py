"""GeoJSON files of circuits: closed lines of longitudes and latitudes, as in bacinger/f1-circuits.

Shapes: `P` points of a line. Latitudes and longitudes are those of WGS 84.
"""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from carrl.errors import TrackError, shown
from carrl.files import read_whole, write_whole
from carrl.tracks.centreline import (
    LONGEST_STEP,
    MAX_COORDINATE,
    MIN_POINTS,
    Centreline,
    Road,
    without_repeats,
)
from carrl.tracks.drawing_file import smooth_curve

MAX_JSON_BYTES = 4 * 2**20
"""The 40 circuits of bacinger/f1-circuits have 0.13 MiB."""
MOST_CIRCUITS, MOST_POSITIONS = 512, 20_000
"""Of a file, and of each of its lines, of which those have at most 203."""
DEFAULT_WIDTH = 12.0
"""Of a road whose file does not have one, m: the least that the FIA's rules ask of a new circuit."""
LONGEST_PIECE = 30.0
"""Into pieces of at most this length a straight is cut before a curve is laid through the points, m. Without, it would
bulge by up to 9 m between points 860 m apart; with it, by 2.4 m at the most on the 40 circuits, at their corners."""
POINT_SPACING, LEAST_POINTS = 2.0, 200
"""About how far points of the curve stand apart, m, unless that makes fewer of them, or more than `MOST_POSITIONS`."""
WIDTHS = ("width_left", "width_right")
NAMES = ("id", "name", "Name", "ID")
"""Of the properties by which a circuit of many is told."""
_EQUATOR, _FLATNESS = 6378137.0, 0.0066943799901413165
"""Radius of the ellipsoid of WGS 84 at the equator, m, and the square of its eccentricity."""


class _Circuit(NamedTuple):
    """One line of a file: what it is called there, its properties and its longitudes and latitudes, [P, 2], degrees."""

    name: str
    properties: dict[str, Any]
    degrees: np.ndarray


def read(path: Path, width: float | None = None) -> list[Road]:
    """The roads of all circuits of a file, each on a plane that touches the earth in its middle, x to the east.

    A file has no widths, unless `write` wrote it: then `width_left` and `width_right` are properties of its line, from
    point to point, and the line is taken as it is; otherwise a curve is laid through the points.

    Args:
        path: of the file.
        width: of the road, m; None for that of the file or else `DEFAULT_WIDTH`.

    Raises:
        TrackError: the file is no GeoJSON of lines in degrees, or one of them is no road.
    """
    if width is not None and not (_is_number(width) and 0 < width <= MAX_COORDINATE):
        raise TrackError(f"track '{path.name}': width is {shown(width)}; it must be a positive number of metres")
    circuits = _circuits(path)
    return [_road(path, each, width, None if len(circuits) == 1 else each.name) for each in circuits]


def write(path: Path, centreline: Centreline) -> None:
    """Writes a line about the point at longitude and latitude 0 that `read` reads back to ten micrometres.

    Raises:
        TrackError: it cannot be written there.
    """
    degrees = _in_degrees(centreline.points, np.zeros(2))
    widths = {name: np.round(getattr(centreline, name), 6).tolist() for name in WIDTHS}
    feature = {
        "type": "Feature",
        "properties": {"name": path.stem, "origin": [0.0, 0.0], **widths},
        "geometry": {"type": "LineString", "coordinates": np.round([*degrees, degrees[0]], 11).tolist()},
    }
    content = json.dumps({"type": "FeatureCollection", "features": [feature]})
    write_whole(path, content.encode(), TrackError)


def _circuits(path: Path) -> list[_Circuit]:
    """The lines of a file; its points, such as those of places, are left out."""
    try:
        document = json.loads(read_whole(path, MAX_JSON_BYTES, f"track '{path.name}'", TrackError).decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise TrackError(f"track '{path.name}': this is not a JSON text file") from None
    kind = document.get("type") if isinstance(document, dict) else None
    features = document.get("features") if kind == "FeatureCollection" else [document]
    if kind == "LineString":
        features = [{"type": "Feature", "geometry": document}]
    if not isinstance(features, list) or not all(isinstance(each, dict) and "geometry" in each for each in features):
        raise TrackError(
            f"track '{path.name}': this JSON is no GeoJSON: it must be a FeatureCollection, a Feature or a LineString"
        )
    circuits: list[_Circuit] = []
    for number, feature in enumerate(features, start=1):
        geometry, properties = feature["geometry"], feature.get("properties")
        properties = properties if isinstance(properties, dict) else {}
        called = (*(properties.get(key) for key in NAMES), feature.get("id"), number)
        name = next(str(each) for each in called if isinstance(each, str | int))[:100]
        name = f"{name}-{number}" if any(name == each.name for each in circuits) else name
        kind, coordinates = _line_of(geometry)
        if len(circuits) == MOST_CIRCUITS:
            raise TrackError(f"track '{path.name}': it has more than {MOST_CIRCUITS} circuits; leave out some")
        if kind == "LineString":
            circuits.append(_Circuit(name, properties, _degrees(path, name, coordinates)))
        elif geometry is not None and kind not in ("Point", "MultiPoint"):
            raise _error(path, name, f"its geometry is {shown(kind)}; it must be a LineString, closed, along the road")
    if not circuits:
        raise TrackError(f"track '{path.name}': there is no LineString in it, so no road; points are only places")
    return circuits


def _line_of(geometry: Any) -> tuple[Any, Any]:
    """Type and coordinates of a geometry, a MultiLineString of one line as that line."""
    if not isinstance(geometry, dict):
        return None, None
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind == "MultiLineString" and isinstance(coordinates, list) and len(coordinates) == 1:
        return "LineString", coordinates[0]
    return kind, coordinates


def _degrees(path: Path, name: str, coordinates: Any) -> np.ndarray:
    if not isinstance(coordinates, list) or not MIN_POINTS <= len(coordinates) <= MOST_POSITIONS:
        raise _error(path, name, f"it must have a list of {MIN_POINTS} to {MOST_POSITIONS} coordinates")
    for number, position in enumerate(coordinates, start=1):
        is_pair = isinstance(position, list) and len(position) >= 2 and all(map(_is_number, position[:2]))
        if not is_pair or not (abs(position[0]) <= 180 and abs(position[1]) <= 90):  # nan fails it, too
            wanted = "[longitude, latitude] in degrees"
            raise _error(path, name, f"position {number} is {shown(position)}; it must be {wanted}")
    return np.array([position[:2] for position in coordinates], dtype=np.float64)


def _road(path: Path, circuit: _Circuit, width: float | None, name: str | None) -> Road:
    """The road on a plane, m."""
    left, right = (_widths(path, circuit, name) for name in WIDTHS)
    as_drawn = left is not None and right is not None
    if (left is None) != (right is None):
        raise _error(path, circuit.name, f"it has one of {' and '.join(WIDTHS)}; give both, or none")
    if as_drawn and width is not None:
        raise _error(path, circuit.name, f"width is {shown(width)}, but this line has widths of its own")
    origin = circuit.properties.get("origin") if as_drawn else None  # another tool's may be anything
    if origin is None:
        origin = _middle(circuit.degrees)
    elif not (isinstance(origin, list) and len(origin) == 2 and all(map(_is_number, origin))):
        raise _error(path, circuit.name, f"origin is {shown(origin)}; it must be [longitude, latitude]")
    points = _in_metres(circuit.degrees, np.asarray(origin, dtype=np.float64))
    if not np.abs(points).max() <= MAX_COORDINATE:
        raise _error(path, circuit.name, f"its points are more than {MAX_COORDINATE / 1000:.0f} km from their middle")
    if left is None or right is None:
        left = right = np.full(len(points), (width or DEFAULT_WIDTH) / 2)
    notes = () if as_drawn or width else (f"no widths, so {DEFAULT_WIDTH:g} m unless track.width says otherwise",)
    table, repeats = without_repeats(np.column_stack([points, left, right]))
    if len(table) < MIN_POINTS:
        raise _error(path, circuit.name, f"{len(table)} points; a closed road needs at least {MIN_POINTS}")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    gap = math.dist(points[0], points[-1])
    if gap > LONGEST_STEP * steps.max():
        raise _error(path, circuit.name, f"the line ends {gap:.0f} m from where it begins; draw it all the way round")
    if not as_drawn:
        table = _curve(path, circuit.name, table)
    line = Centreline(points=table[:, :2], width_left=table[:, 2], width_right=table[:, 3], repeats=repeats)
    return replace(line.road(), name=name, notes=notes)


def _curve(path: Path, name: str, table: np.ndarray) -> np.ndarray:
    """A smooth line through the points, and nearly straight between those far apart."""
    ways = np.roll(table, -1, axis=0) - table
    lengths = np.linalg.norm(ways[:, :2], axis=1)
    if lengths.sum() > MAX_COORDINATE:
        raise _error(path, name, f"it is {lengths.sum() / 1000:,.0f} km long; a road has at most 100 km")
    pieces = np.ceil(lengths / LONGEST_PIECE).astype(int)
    share = np.concatenate([np.arange(count) / count for count in pieces.tolist()])
    closer = np.repeat(table, pieces, axis=0) + share[:, None] * np.repeat(ways, pieces, axis=0)
    count = min(max(lengths.sum() / POINT_SPACING, LEAST_POINTS), MOST_POSITIONS)
    curve, _ = without_repeats(smooth_curve(closer, lengths.sum() / count))
    if len(curve) < MIN_POINTS:
        raise _error(path, name, "it is too small a road")
    return curve


def _widths(path: Path, circuit: _Circuit, name: str) -> np.ndarray | None:
    """From each point to the wall on one side, m, if the file has it."""
    widths = circuit.properties.get(name)
    if widths is None:
        return None
    count = len(circuit.degrees)
    closed = bool((circuit.degrees[0] == circuit.degrees[-1]).all())
    fits = isinstance(widths, list) and len(widths) in (count, count - closed) and all(map(_is_number, widths))
    if not fits or not all(0 < each <= MAX_COORDINATE for each in widths):
        raise _error(path, circuit.name, f"{name} must be a list of a positive number of metres for each position")
    return np.asarray([*widths, *widths[: count - len(widths)]], dtype=np.float64)


def _middle(degrees: np.ndarray) -> np.ndarray:
    """Longitude and latitude of the middle of positions [P, 2], also where the 180th meridian parts them."""
    places = _on_earth(degrees)
    x, y, z = places.min(axis=0) + places.max(axis=0)
    return np.degrees([math.atan2(y, x), math.atan2(z / (1 - _FLATNESS), math.hypot(x, y))])


def _in_metres(degrees: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Positions [P, 2] east and north of an origin [2] on the plane that touches the earth there, [P, 2], m."""
    east, north, _ = _axes(origin)
    return np.asarray((_on_earth(degrees) - _on_earth(origin)) @ np.stack([east, north], axis=1))


def _in_degrees(metres: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The reverse of `_in_metres`: where a plumb line from the plane meets the earth."""
    east, north, up = _axes(origin)
    plane = _on_earth(origin) + metres @ np.stack([east, north])
    axes = np.array([1.0, 1.0, math.sqrt(1 - _FLATNESS)]) * _EQUATOR
    a, b, c = ((up / axes) ** 2).sum(), (plane / axes) @ (up / axes), ((plane / axes) ** 2).sum(axis=1) - 1
    x, y, z = (plane + ((np.sqrt(b**2 - a * c) - b) / a)[:, None] * up).T
    return np.degrees(np.stack([np.arctan2(y, x), np.arctan2(z / (1 - _FLATNESS), np.hypot(x, y))], axis=1))


def _on_earth(degrees: np.ndarray) -> np.ndarray:
    """Points on the ellipsoid, [..., 3], m from its centre: to longitude 0, to 90 degrees east, and to the north."""
    longitude, latitude = np.radians(degrees)[..., 0], np.radians(degrees)[..., 1]
    radius = _EQUATOR / np.sqrt(1 - _FLATNESS * np.sin(latitude) ** 2)
    x, y = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    return np.stack([x, y, (1 - _FLATNESS) * np.sin(latitude)], axis=-1) * radius[..., None]


def _axes(origin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors to the east, to the north and upwards at a longitude and latitude."""
    longitude, latitude = np.radians(origin).tolist()
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    level = np.array([math.cos(longitude), math.sin(longitude), 0.0])
    up = math.cos(latitude) * level + np.array([0.0, 0.0, math.sin(latitude)])
    return east, np.cross(up, east), up


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _error(path: Path, name: str, what: str) -> TrackError:
    return TrackError(f"track '{path.name}': circuit {shown(name)}: {what}")
