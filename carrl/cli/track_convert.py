"""`carrl track convert`, and the flags that say how a track's file is to be read."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.errors import TrackError, printable
from carrl.tracks.names import check_may_exist

if TYPE_CHECKING:
    from carrl.tracks.track import Track

DIRECTIONS = ("clockwise", "counterclockwise")
_FLAGS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("--scale", {"type": float, "default": 1.0, "metavar": "F", "help": "times as large, as 10 for a 1:10 car's road"}),
    ("--width", {"type": float, "metavar": "M", "help": "of the road, m, for a file without widths"}),
    ("--walls", {"choices": ("road", "barriers"), "help": "of a track of TORCS: its edges, or what stops a car"}),
    ("--circuit", {"metavar": "NAME", "help": "which one of a file that has many"}),
    ("--direction", {"choices": DIRECTIONS, "help": "to drive; default: that of the file"}),
)


def add_reading_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the options that `carrl train` knows as `track.scale`, `track.width` and so on."""
    for flag, options in _FLAGS:
        parser.add_argument(flag, **options)


def load_as_said(arguments: argparse.Namespace, name: str | None = None) -> "Track":
    """The track of that name, or the one of the arguments, read as their flags say."""
    from carrl.tracks.track import Track

    return Track.load(name or arguments.track, circuit=arguments.circuit, **_said(arguments))


def load_all_as_said(arguments: argparse.Namespace, name: str) -> "list[Track]":
    """All circuits of that name, or the one that the flags choose."""
    from carrl.tracks.track import Track

    return Track.load_all(name, **_said(arguments)) if arguments.circuit is None else [load_as_said(arguments, name)]


def _said(arguments: argparse.Namespace) -> dict[str, Any]:
    return {name: getattr(arguments, name) for name in ("scale", "width", "direction", "walls")}


def add_convert_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds what `carrl track convert` takes."""
    parser.add_argument("track", metavar="IN", help="a built-in track, a file, or the name of a file in CARRL_TRACKS")
    parser.add_argument(
        "out", metavar="OUT", help="NAME.csv, .yaml (a drawing), .npy, .geojson, or .png or .pgm for a map of ROS"
    )
    add_reading_flags(parser)
    parser.add_argument(
        "--resolution", type=float, metavar="M", help="of a map, m a pixel (default: by the road's width)"
    )
    parser.add_argument("--force", action="store_true", help="replace files that are there already")


def run_convert(arguments: argparse.Namespace) -> int:
    """Converts, and returns 1 where a wall read back is further off than the format's tolerance."""
    check_may_exist(arguments.track)
    from carrl.tracks.convert import convert, files_of  # From here on it takes seconds.

    track, path = load_as_said(arguments), Path(arguments.out)
    for file in files_of(path):
        if file.exists() and not arguments.force:
            raise TrackError(f"'{file}' is there already; choose another OUT, or --force to replace it")
    done = convert(track, path, arguments.resolution)
    for file in done.files:
        print(printable(str(file)))
    verdict = f"read back, its walls are within {done.apart:.3g} m; the tolerance is {done.tolerance:.3g} m"
    print(verdict if done.apart <= done.tolerance else f"fault: {verdict}")
    return int(done.apart > done.tolerance)
