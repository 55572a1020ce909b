"""The formats of track files: a reader for each ending of a file's name."""

import os
from collections.abc import Callable
from pathlib import Path

from carrl.errors import TrackError
from carrl.tracks.centreline import Road
from carrl.tracks.csv_file import read_csv
from carrl.tracks.drawing_file import read_drawing
from carrl.tracks.waypoint_file import read_waypoints


def _read_centreline(path: Path) -> Road:
    return read_csv(path).road()


READERS: dict[str, Callable[[Path], Road]] = {
    ".csv": _read_centreline,
    ".npy": read_waypoints,
    ".yaml": read_drawing,
    ".yml": read_drawing,
}
"""By the ending in small letters; add one to read tracks of another format. Each raises TrackError for a bad file."""


def read_road(path: Path) -> Road:
    """The road of a file: by its ending, or else as CSV.

    Raises:
        TrackError: it is a folder, or does not describe a road.
    """
    if os.path.isdir(path):  # Path.is_dir raises on a name that is too long or may not be looked up.
        raise TrackError(f"track '{path}': this is a folder; name a file in it")
    return READERS.get(path.suffix.lower(), _read_centreline)(path)
