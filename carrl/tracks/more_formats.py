"""Formats of which a file may hold many tracks, by the ending of its name."""

import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from carrl.errors import TrackError, shown
from carrl.tracks import geojson, opendrive, torcs
from carrl.tracks.track import Track
from carrl.tracks.xml_file import root_tag

Reader = Callable[..., list[Track]]

OF_ROOT: Mapping[str, Reader] = {"params": torcs.read, "OpenDRIVE": opendrive.read}
"""Readers of XML by the name of its outermost element."""
OF_ENDING: Mapping[str, Reader] = {".geojson": geojson.read, ".json": geojson.read, ".xodr": opendrive.read}
ENDINGS = (".xml", *OF_ENDING)


def reader_of(path: Path) -> Reader | None:
    """What reads a file; None where that is none of these readers, or there is no such file.

    Raises:
        TrackError: it is XML that none of them reads.
    """
    ending = path.suffix.lower()
    if not os.path.isfile(path):  # Path.is_file raises on a name that is too long
        return None
    if ending != ".xml":
        return OF_ENDING.get(ending)
    tag = root_tag(path)
    if tag not in OF_ROOT:
        raise TrackError(
            f"track '{path.name}': this XML is {shown(tag)}; CarRL reads params, as of TORCS, and OpenDRIVE"
        )
    return OF_ROOT[tag]


def check_options(name: str, reader: Reader | None, options: Mapping[str, Any]) -> None:
    """Raises TrackError for options that the file's format does not have."""
    known = [] if reader is None else list(inspect.signature(reader).parameters)[2:]
    unknown = [option for option in options if option not in known]
    if unknown:
        raise TrackError(
            f"track '{name}': it has no option {', '.join(unknown)}; it has {', '.join(known) or 'only gate_spacing'}"
        )


def read_one(path: Path, reader: Reader, gate_spacing: float | None, options: Mapping[str, Any]) -> Track:
    """The only track of a file.

    Raises:
        TrackError: it has none, or many.
    """
    tracks = reader(path, gate_spacing=gate_spacing, **options)
    if len(tracks) != 1:
        names = ", ".join(track.name.removeprefix(f"{path.name}/") for track in tracks)
        raise TrackError(f"track '{path.name}': it has {len(tracks)} circuits; choose one by circuit: {names[:1000]}")
    return tracks[0]
