"""Writes tracks in the formats that other tools read, and tells how well they read back."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from carrl.errors import TrackError
from carrl.files import write_whole
from carrl.tracks import geojson, ros_map, waypoint_file
from carrl.tracks.adjust import as_centreline, walls_apart
from carrl.tracks.bridges import cut_folds
from carrl.tracks.csv_file import write_csv
from carrl.tracks.track import Track

TOLERANCE, MAP_TOLERANCE = 0.06, 2.5
"""How far a wall may be from where it was, in least widths of the road; on a map in pixels, if that is more. Nearly all
are 100 times closer; but no offset of a centreline, and no pixels, draw the tip of a hairpin's inner wall."""
RESOLUTIONS = 1e-3, 100.0
"""Of maps, m a pixel."""
_PIXELS_ACROSS, _FINEST = 40, 0.05
_MOST_SIDE = 4000


class Conversion(NamedTuple):
    """What came of a conversion.

    Attributes:
        files: that were written.
        apart: the largest distance of a wall, read back, from where it was, m.
        tolerance: the largest one that is no fault, m.
    """

    files: list[Path]
    apart: float
    tolerance: float


def convert(track: Track, path: Path, resolution: float | None = None) -> Conversion:
    """Writes a track in the format that the ending of a path names, and reads it back.

    Args:
        track: any.
        path: NAME.csv, .yaml (a drawing), .npy (of AWS DeepRacer), .geojson, or .png or .pgm for a map of ROS.
        resolution: of a map, m a pixel; None for `default_resolution`.

    Raises:
        TrackError: no format has that ending, the format cannot hold the track, or a file cannot be written.
    """
    ending = path.suffix.lower()
    if ending not in WRITERS:
        raise TrackError(f"'{path}' must end in {', '.join(WRITERS)}; .png and .pgm are maps of ROS")
    if resolution is not None and ending not in MAPS:
        raise TrackError(f"'{path}': a resolution is for maps, {' and '.join(MAPS)}; leave it out")
    pixel = 0.0
    if ending in MAPS:
        pixel = default_resolution(track) if resolution is None else resolution
        if not RESOLUTIONS[0] <= pixel <= RESOLUTIONS[1]:
            raise TrackError(f"the resolution is {pixel:g}; it must be from {RESOLUTIONS[0]:g} to {RESOLUTIONS[1]:g} m")
    files = WRITERS[ending](path, track, pixel)
    back = Track.load(path.with_suffix(".yaml") if ending in MAPS else path)
    least = float(np.linalg.norm((track.left_wall - track.right_wall).numpy(), axis=1).min())
    return Conversion(files, walls_apart(track, back), max(TOLERANCE * least, MAP_TOLERANCE * pixel))


def files_of(path: Path) -> list[Path]:
    """All files that `convert` writes for this one."""
    if path.suffix.lower() not in MAPS:
        return [path]
    return [path, path.with_suffix(".yaml"), path.with_name(f"{path.stem}_centerline.csv")]


def default_resolution(track: Track) -> float:
    """Of a map, m a pixel: 5 cm, or a fortieth of a narrower road, or what makes a large picture of 4,000 pixels."""
    walls = np.concatenate([track.left_wall.numpy(), track.right_wall.numpy()])
    least = float(np.linalg.norm((track.left_wall - track.right_wall).numpy(), axis=1).min())
    return max(min(_FINEST, least / _PIXELS_ACROSS), float(np.ptp(walls, axis=0).max()) / _MOST_SIDE)


def _write_csv(path: Path, track: Track, _: float) -> list[Path]:
    write_csv(path, as_centreline(track))
    return [path]


def _write_drawing(path: Path, track: Track, _: float) -> list[Path]:
    """A drawing through points, with the widths to both sides of each."""
    line = as_centreline(track)
    points = np.column_stack([line.points, line.width_right, line.width_left]).tolist()
    rows = [f"  - [{x:.6f}, {y:.6f}, {right:.6f}, {left:.6f}]" for x, y, right, left in points]
    text = "\n".join([f"gates: {track.gate_count}", "smooth: false", "points:", *rows, ""])
    write_whole(path, text.encode(), TrackError)
    return [path]


def _write_waypoints(path: Path, track: Track, _: float) -> list[Path]:
    middle, left, right = (line.double().numpy() for line in (track.centreline, track.left_wall, track.right_wall))
    if not (waypoint_file.is_abreast(middle, left) and waypoint_file.is_abreast(middle, right)):
        line = as_centreline(track)
        middle, (left, right) = line.points, (cut_folds(wall, line.points) for wall in line.walls())
    waypoint_file.write_waypoints(path, middle, left, right)
    return [path]


def _write_geojson(path: Path, track: Track, _: float) -> list[Path]:
    geojson.write(path, as_centreline(track))
    return [path]


MAPS = (".png", ".pgm")
WRITERS: Mapping[str, Callable[[Path, Track, float], list[Path]]] = {
    ".csv": _write_csv,
    ".yaml": _write_drawing,
    ".yml": _write_drawing,
    ".npy": _write_waypoints,
    ".geojson": _write_geojson,
    ".png": ros_map.write,
    ".pgm": ros_map.write,
}
