"""The limits that `carrl evaluate` compares lap times with, as typed or found."""

import argparse
import logging
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from carrl.errors import ConfigError

if TYPE_CHECKING:
    from carrl.sim.vehicle import VehicleModel
    from carrl.tracks.track import Track

AUTO = "auto"
"""Instead of a limit: those of all other tracks are found."""


def asked_limits(texts: Sequence[str]) -> dict[str, float]:
    """The limits of tracks as typed.

    Raises:
        ConfigError: one is not written as TRACK=SECONDS, or there are two of a track.
    """
    if texts.count(AUTO) > 1:
        raise ConfigError(f"--limit {AUTO} is given twice; leave one of them out")
    limits: dict[str, float] = {}
    for text in texts:
        if text == AUTO:
            continue
        name, _, seconds = text.rpartition("=")
        try:
            limit = float(seconds)
        except ValueError:
            limit = math.nan
        if not name or math.isnan(limit):
            raise ConfigError(f"--limit is {text!r}; write it as TRACK=SECONDS, such as oval=20.5, or auto")
        if name in limits:
            raise ConfigError(f"--limit is given twice for track '{name}'; leave one of them out")
        limits[name] = limit
    return limits


def limits_for(arguments: argparse.Namespace, tracks: "Sequence[Track]", vehicle: "VehicleModel") -> dict[str, float]:
    """Those that were typed and, where it was asked for, the minimum lap times of this car on the other tracks, s.

    Raises:
        CarrlError: one cannot be found.
    """
    asked: dict[str, float] = arguments.limits
    if AUTO not in arguments.limit:
        return asked
    from carrl.racing.kept_laps import minimum_lap_times

    _show_searches()
    others = [track for track in tracks if track.name not in asked]
    return {**asked, **minimum_lap_times(others, vehicle)}


def _show_searches() -> None:
    """Lets what is looked for, and takes long, be told on standard error."""
    logger = logging.getLogger("carrl.racing")
    logger.setLevel(logging.INFO)
    logger.handlers[:] = [logging.StreamHandler()]  # of today's standard error
