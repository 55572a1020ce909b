"""Minimum laps kept between processes, in the user's cache folder, as JSON.

A lap's file is named after all that it depends on: the road, the car, the grid, and the code that found it.
"""

import hashlib
import json
import logging
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carrl.cache import CacheError, forget_least_used, is_own, own_cache_dir
from carrl.errors import CarrlError, TrackError
from carrl.files import read_whole, write_whole
from carrl.racing.equations import casadi
from carrl.racing.minimum_lap import MinimumLap, checked_car, minimum_lap, point_mass_lap
from carrl.racing.reference_line import COLUMNS, from_table

if TYPE_CHECKING:
    from carrl.sim.vehicle import VehicleModel
    from carrl.tracks.track import Track

MAX_BYTES = 128 * 2**20
"""Laps beyond this, some 500 of them, are forgotten, the least recently used first."""
MAX_FILE_BYTES = 16 * 2**20
_FIGURES = ("model", "spacing", "margin", "iterations", "seconds", "at_grip_limit", "at_walls")

_logger = logging.getLogger(__name__)


def kept_lap(
    track: "Track",
    vehicle: "VehicleModel",
    spacing: float | None = None,
    margin: float = 0.0,
    quick: bool = False,
) -> MinimumLap:
    """The minimum lap, or with `quick` the point mass's, from the cache or else found and kept there.

    Raises:
        CarrlError: as `minimum_lap`.
    """
    casadi()  # whose version counts; a missing one is told at once
    checked_car(vehicle)

    def find() -> MinimumLap:
        return (point_mass_lap if quick else minimum_lap)(track, vehicle, spacing, margin)

    try:
        folder = own_cache_dir()
    except (CacheError, OSError) as error:
        _logger.warning("Minimum laps are not kept: %s.", error)
        return find()
    path = folder / f"lap-{_fingerprint(track, vehicle, spacing, margin, quick)}.json"
    kept = _read(path)
    if kept is None:
        _logger.info("finding the minimum lap of track '%s'; it is kept for the next time", track.name)
        kept = find()
        try:
            write_whole(path, _as_json(kept).encode())
            path.chmod(0o600)
            forget_least_used(folder, "lap-*.json", MAX_BYTES, path)
        except (CarrlError, OSError) as error:  # the lap itself is none the worse
            _logger.warning("The minimum lap is not kept: %s.", error)
    return kept


def minimum_lap_times(tracks: Iterable["Track"], vehicle: "VehicleModel") -> dict[str, float]:
    """The least time for a flying lap of each track, by its name, s; found as `kept_lap` does.

    Raises:
        CarrlError: as `kept_lap`.
    """
    return {track.name: kept_lap(track, vehicle).lap_time for track in tracks}


def _fingerprint(track: "Track", vehicle: "VehicleModel", *settings: object) -> str:
    """Of all that the lap depends on."""
    digest = hashlib.sha256(track.road.numpy().tobytes())
    parts = type(vehicle).__name__, sorted(vars(vehicle).items()), settings, casadi().__version__
    digest.update(repr(parts).encode())
    own = Path(__file__).parent
    for file in (*sorted(own.glob("*.py")), *(own.parent / "sim" / name for name in ("driven.py", "tyres.py"))):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:32]


def _read(path: Path) -> MinimumLap | None:
    """The lap in a file, now the most recently used; None where there is none, or a damaged one, which is deleted."""
    try:
        if not path.is_symlink() and not path.exists():
            return None
        if path.is_symlink() or not is_own(path.lstat()):
            raise TrackError("it is not the user's own file")
        document = json.loads(read_whole(path, MAX_FILE_BYTES, "lap", TrackError, follow_links=False))
        os.utime(path)
        return _from_json(document)
    except (OSError, TrackError, ValueError, KeyError, TypeError) as error:
        _logger.warning("The kept lap '%s' cannot be used (%s); it is deleted.", path, error)
        with suppress(OSError):
            path.unlink()
        return None


def _as_json(lap: MinimumLap) -> str:
    closed = lap.line.closed()
    columns = {name: getattr(closed, name).tolist() for name in COLUMNS.values()}
    return json.dumps({"figures": {name: getattr(lap, name) for name in _FIGURES}, "columns": columns})


def _from_json(document: Any) -> MinimumLap:
    """Raises an error of one of some kinds where it is none."""
    table = np.stack([np.array(document["columns"][name], dtype=np.float64) for name in COLUMNS.values()], axis=1)
    figures = {name: document["figures"][name] for name in _FIGURES}
    if not all(isinstance(value, str | int | float | None) for value in figures.values()):
        raise TypeError("a figure is no number")
    return MinimumLap(line=from_table(table, "lap"), **figures)
