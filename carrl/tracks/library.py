"""The folders whose tracks go by their names: those of the environment variable `CARRL_TRACKS`."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from carrl.errors import TrackError
from carrl.tracks.centreline import Road
from carrl.tracks.drawing_file import DRAWINGS
from carrl.tracks.formats import READERS, check_options, read_roads
from carrl.tracks.names import VARIABLE, unknown_track

_PARTS = ("_centerline", "_centreline", "_raceline")
"""Endings of the names of files that belong to another one."""
MOST_FILES = 100_000
"""That are looked at in the folders of the library."""


def library_folders() -> list[Path]:
    """The folders that `CARRL_TRACKS` names, parted as in PATH.

    Raises:
        TrackError: one of them is no folder.
    """
    folders = [Path(each) for each in os.environ.get(VARIABLE, "").split(os.pathsep) if each]
    for folder in folders:
        if not folder.is_dir():
            raise TrackError(f"{VARIABLE} names '{folder}', which is no folder; correct it or unset it")
    return folders


def find_file(name_or_path: str | Path) -> Path | None:
    """The file of this path, or else the one of this name in the library, with or without its ending; None if neither.

    Raises:
        TrackError: there are several of this name, or the library cannot be read.
    """
    if os.path.exists(name_or_path):  # Path.exists raises on a name that is too long or may not be looked up.
        return Path(name_or_path)
    name = str(name_or_path)
    if not os.environ.get(VARIABLE) or not name or os.sep in name:
        return None
    found = [path for folder in library_folders() for path in files_below(folder) if name in (path.name, path.stem)]
    exact = [path for path in found if path.name == name] or found
    if len(exact) > 1:
        raise TrackError(
            f"track '{name}': {len(exact)} files of {VARIABLE} have this name: "
            f"{', '.join(map(str, exact[:5]))}; give the path of one of them"
        )
    return exact[0] if exact else None


def roads_of(name_or_path: str | Path, **options: Any) -> list[tuple[str, Road]]:
    """The roads of a built-in track or of a file, each with its name; the options are those of `read_roads`.

    Raises:
        TrackError: there is no such track or file, it does not describe a road, or it does not have such an option.
    """
    name = str(name_or_path)
    if name in DRAWINGS:
        check_options(name, [], {key: value for key, value in options.items() if value is not None})
        drawing = DRAWINGS[name]
        return [(name, drawing.centreline().road(drawing.gate_count))]
    path = find_file(name_or_path)
    if path is None:
        raise unknown_track(name)
    roads = read_roads(path, **options)
    return [(path.name if road.name is None else f"{path.name}/{road.name}", road) for road in roads]


def files_below(folder: Path) -> Iterator[Path]:
    """The files of a folder, and of those below it that are not hidden, that are taken for circuits, in order.

    A file that belongs to another one is left out: the centreline of a map, the raceline of a centreline.

    Raises:
        TrackError: a folder cannot be read, or holds very many files.
    """

    def refuse(error: OSError) -> None:
        raise TrackError(f"folder '{error.filename}' cannot be read: {error.strerror}; name a folder of circuits")

    seen = 0
    for path, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        seen += len(names)
        if seen > MOST_FILES:
            raise TrackError(f"folder '{folder}' has more than {MOST_FILES:,} files; name one with fewer")
        stems = {os.path.splitext(name)[0] for name in names}
        for name in sorted(names):
            stem, ending = os.path.splitext(name)
            if name.startswith(".") or ending.lower() not in READERS or _belongs_to_another(stem, stems):
                continue
            if (file := Path(path, name)).is_file():
                yield file


def _belongs_to_another(stem: str, stems: set[str]) -> bool:
    """Whether a file is the centreline or raceline of a track of which there is another file in its folder."""
    for part in _PARTS:
        name = stem.removesuffix(part)
        if name != stem:
            others = {name, f"{name}_map"} | (
                {f"{name}{each}" for each in _PARTS[:2]} if part == "_raceline" else set()
            )
            return bool(others & stems)
    return False
