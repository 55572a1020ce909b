"""The formats of track files: a reader for each ending of a file's name."""

import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from carrl.errors import TrackError, shown
from carrl.tracks import geojson, opendrive, raceline, ros_map, torcs
from carrl.tracks.centreline import Road
from carrl.tracks.drawing_file import read_drawing
from carrl.tracks.waypoint_file import read_waypoints
from carrl.tracks.xml_file import root_tag

Reader = Callable[..., Road | list[Road]]
"""Takes the path, and as keywords the options of its format, such as `width`."""


def _read_yaml(path: Path) -> Road:
    return ros_map.read(path) if ros_map.is_map(path) else read_drawing(path)


def _read_xml(path: Path, walls: str | None = None) -> Road | list[Road]:
    tag = root_tag(path)
    if tag == "params":
        return torcs.read(path, walls or torcs.WALLS[0])
    if tag == "OpenDRIVE":
        check_options(path.name, [], {} if walls is None else {"walls": walls})
        return opendrive.read(path)
    raise TrackError(f"track '{path.name}': this XML is {shown(tag)}; CarRL reads params, as of TORCS, and OpenDRIVE")


def _read_unknown(path: Path, width: float | None = None) -> Road:
    try:
        return raceline.read(path, width)
    except TrackError as error:
        raise TrackError(f"{error}; as its name ends in none of {', '.join(READERS)}, it was read as CSV") from None


PICTURES = (".png", ".pgm", ".bmp", ".jpg", ".jpeg")
READERS: dict[str, Reader] = {
    ".csv": raceline.read,
    ".npy": read_waypoints,
    ".yaml": _read_yaml,
    ".yml": _read_yaml,
    ".xml": _read_xml,
    ".xodr": opendrive.read,
    ".geojson": geojson.read,
}
"""By the ending in small letters; add one to read tracks of another format. Each raises TrackError for a bad file."""


def read_roads(path: Path, **options: Any) -> list[Road]:
    """The roads of a file: by its ending, or else as CSV.

    Args:
        path: of the file.
        options: of its format; None for those that are not given.

    Raises:
        TrackError: it is a folder, does not describe a road, or its format has no such option.
    """
    if os.path.isdir(path):  # Path.is_dir raises on a name that is too long or may not be looked up.
        raise TrackError(f"track '{path}': this is a folder; name a file in it")
    if path.suffix.lower() in PICTURES and os.path.isfile(path):
        raise TrackError(f"track '{path.name}': this is a picture; name the YAML file beside it that makes it a map")
    reader = READERS.get(path.suffix.lower(), _read_unknown)
    given = {key: value for key, value in options.items() if value is not None}
    check_options(path.name, list(inspect.signature(reader).parameters)[1:], given)
    roads = reader(path, **given)
    return [roads] if isinstance(roads, Road) else roads


def check_options(name: str, known: list[str], given: Mapping[str, Any]) -> None:
    """Raises TrackError for options that a track does not have."""
    for option in given:
        if option not in known:
            has = f"its format has {', '.join(known)}" if known else "its format has none"
            raise TrackError(f"track '{name}': it takes no {option}; {has}, so leave it out")
