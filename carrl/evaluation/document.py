"""The figures of an evaluation as one document, ready for JSON: of each track, and of all together."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from carrl.errors import ConfigError, shown
from carrl.evaluation.results import Rollout, aggregate, mean_or_none, rounded
from carrl.racing import SECTORS
from carrl.tracks.track import Track

Laps = list[list[Rollout]]
"""The drives of each track."""


def evaluation_figures(
    tracks: Sequence[Track], runs: list[Laps], rule: Laps | None, step_length: float, limits: Mapping[str, float]
) -> dict[str, Any]:
    """The figures of each track and of all, each with those of the rule; lap times only of each track.

    Args:
        tracks: that were driven.
        runs: the drives of each run.
        rule: those of the rule; None where it cannot drive the car.
        step_length: metres that a car drives in a step, if its speed never varies.
        limits: the least time for a flying lap of tracks, by their names, s.
    """

    def figures(own: Sequence[Sequence[Rollout]], name: str) -> dict[str, Any]:
        drives = [drive for run in own for drive in run]
        return aggregate(own, step_length) | {"lap_times": lap_figures(drives, limits.get(name))}

    of_tracks = [
        {
            "track": track.name,
            "length_m": track.length,
            **figures([laps[index] for laps in runs], track.name),
            "drives": [drive.measures() | {"laps": drive.laps()} for laps in runs for drive in laps[index]],
            **({} if rule is None else {"rule": figures([rule[index]], track.name)}),
        }
        for index, track in enumerate(tracks)
    ]
    everything = aggregate([_together(laps) for laps in runs], step_length)
    if rule is not None:
        everything["rule"] = aggregate([_together(rule)], step_length)
    return {"tracks": of_tracks, "all": everything}


def _together(laps: Laps) -> list[Rollout]:
    return [drive for of_track in laps for drive in of_track]


def lap_figures(drives: Sequence[Rollout], limit: float | None = None) -> dict[str, Any]:
    """The lap times of drives on one track, ready for JSON: standing and flying laps apart, those that count.

    Args:
        drives: on the track.
        limit: the least time that the car could take for a flying lap there, s, if it is known.
    """
    standing = [laps for drive in drives for laps in drive.sector_times[: drive.standing_laps]]
    flying = [laps for drive in drives for laps in drive.sector_times[drive.standing_laps :]]
    kinds = {"standing": standing, "flying": flying}
    figures: dict[str, Any] = {kind: _lap_figures(laps, limit) for kind, laps in kinds.items() if laps}
    return figures | ({} if limit is None else {"limit_s": rounded(limit)})


def _lap_figures(laps: Sequence[Sequence[float]], limit: float | None) -> dict[str, Any]:
    counted = [sectors for sectors in laps if len(sectors) == SECTORS]
    times = [math.fsum(sectors) for sectors in counted]
    mean = mean_or_none(times)
    figures = {
        "begun": len(laps),
        "counted": len(counted),
        "mean_s": rounded(mean),
        "best_s": rounded(min(times, default=None)),
        "sectors_s": [rounded(mean_or_none(sector)) for sector in zip(*counted, strict=True)],
    }
    return figures if limit is None or mean is None else figures | {"share_of_limit": mean / limit}


def checked_limits(limits: Mapping[str, float], tracks: Sequence[Track]) -> Mapping[str, float]:
    """The limits.

    Raises:
        ConfigError: one is no time, or of no track that is driven.
    """
    names = {track.name for track in tracks}
    for name, limit in limits.items():
        if name not in names:
            raise ConfigError(f"a limit is given for track {shown(name)}, which is not driven; driven: {_some(names)}")
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit < math.inf:
            raise ConfigError(f"the limit of track '{name}' is {shown(limit)}; it must be a positive number of seconds")
    return limits


def _some(names: Collection[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(sorted(names)[:most]) + more
