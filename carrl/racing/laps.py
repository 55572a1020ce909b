"""Laps beside each other: when each was where along the road, and how far behind another it was there.

A lap begins at the start line, at 0 s. Racers compare laps over the way along the road, not over time: the *gap* is by
how many seconds a lap came later to a place than another, as both began together.

Shapes: `M` moments, `K` any stations or times.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from carrl.errors import TrackError
from carrl.racing import SECTORS
from carrl.sim.places import stations_along
from carrl.tracks.track import Track

Floats = NDArray[np.float64]

FINEST = 0.02
"""Between two moments of a lap, at most, s: shorter than any driver's step."""
OFF_THE_ROAD = 1.5
"""A car so many times as far from the centreline as the wall is was driven on another road."""
LONGEST = 3600.0
"""Of a lap, s: with more between its first and its last moment it is none."""
AT_REST = 0.5
"""A car that is slower than this at the start line, m/s, begins from rest."""


@dataclass(frozen=True, eq=False)
class Lap:
    """A lap of a road, from its start line on.

    Attributes:
        name: for readers.
        length: of the centreline, m.
        time: of each moment, since the start line, [M], s.
        station: along the centreline, counted on past the start line, [M], m.
        poses: x, y and heading, [M, 3], m, m, rad; the heading is counted on through full turns.
        speed: [M], m/s.
    """

    name: str
    length: float
    time: Floats
    station: Floats
    poses: Floats
    speed: Floats

    @staticmethod
    def of(name: str, track: Track, time: Floats, poses: Floats, speed: Floats) -> "Lap":
        """The lap that was driven through these moments; between them the way is a smooth curve.

        Args:
            name: of the lap.
            track: where it was driven, from its start line on: the first moment may be a step before it or after it.
            time: [M], s.
            poses: [M, 3].
            speed: [M], m/s.

        Raises:
            TrackError: the moments are not on this road, begin elsewhere, or take longer than `LONGEST`.
        """
        if time[-1] - time[0] > LONGEST:
            raise TrackError(
                f"lap '{name}': it takes {time[-1] - time[0]:,.0f} s; it may take at most {LONGEST:,.0f} s, so correct "
                "its times"
            )
        if np.abs(poses[:, :2] - track.centreline[0].numpy()).max() > track.length:  # far beyond any wall
            raise _left_the_road(name, track)
        fine = np.linspace(time[0], time[-1], max(2, 1 + int(np.ceil((time[-1] - time[0]) / FINEST))))
        places, heading = poses[:, :2], np.unwrap(poses[:, 2])
        between = CubicHermiteSpline(time, places, np.gradient(places, time, axis=0))(fine)
        poses = np.column_stack([between, np.interp(fine, time, heading)])
        speed = np.interp(fine, time, speed)
        longest = float(np.linalg.norm(np.diff(between, axis=0), axis=1).max())
        stations, sides = stations_along(track, torch.from_numpy(poses), 0.0, longest)
        if np.abs(sides).max() > OFF_THE_ROAD:
            raise _left_the_road(name, track)
        station = np.unwrap(stations.astype(np.float64), period=track.length)
        station -= track.length * np.round(station[0] / track.length)
        if abs(station[0]) > 0.01 + speed[0] * np.diff(time).max():
            raise TrackError(
                f"lap '{name}': it begins {station[0]:,.1f} m along the road of track '{track.name}'; it must begin at "
                "the start line"
            )
        return Lap(name, track.length, fine - _time_at_line(fine, station, speed), station, poses, speed)

    @property
    def lap_time(self) -> float | None:
        """Back at the start line, s; None where the drive ended before."""
        time = float(self.time_at(np.array([self.length]))[0])
        return None if np.isnan(time) else time

    @property
    def sector_times(self) -> tuple[float | None, ...]:
        """Of each third of the centreline, s; None of those that were not completed."""
        times = self.time_at(np.linspace(0, self.length, SECTORS + 1))
        return tuple(None if np.isnan(end) else float(end - begin) for begin, end in pairwise(times))

    @property
    def is_standing(self) -> bool:
        """Whether it begins from rest."""
        return bool(self.speed[0] < AT_REST)

    @property
    def end(self) -> tuple[float, float]:
        """Where the lap ends, or the drive does before that: the station, m, and the time, s."""
        time = self.lap_time
        return (float(self._passed[1][-1]), float(self._passed[0][-1])) if time is None else (self.length, time)

    def time_at(self, stations: Floats) -> Floats:
        """When the car came to each station first, [K], s; NaN beyond the last one."""
        times, passed = self._passed
        return np.interp(stations, passed, times, right=np.nan)

    def speed_at(self, stations: Floats) -> Floats:
        """How fast the car came to each station first, [K], m/s; NaN beyond the last one."""
        times = self.time_at(stations)
        return np.where(np.isnan(times), np.nan, np.interp(times, self.time, self.speed))

    def gap_to(self, reference: "Lap", stations: Floats) -> Floats:
        """By how much it came later to each station than another lap, [K], s; NaN where one of them did not come."""
        return self.time_at(stations) - reference.time_at(stations)

    def at(self, times: NDArray[np.floating[Any]]) -> tuple[Floats, Floats, Floats]:
        """Poses [K, 3], stations [K] and speeds [K] at these times; after the end those of the end."""
        times = np.clip(times, 0, self.end[1])
        poses = np.column_stack([np.interp(times, self.time, column) for column in self.poses.T])
        return poses, np.interp(times, self.time, self.station), np.interp(times, self.time, self.speed)

    @cached_property
    def _passed(self) -> tuple[Floats, Floats]:
        """Times and stations, both of which only grow, from line to line, where less than a moment is missing."""
        furthest = np.maximum.accumulate(self.station)
        ahead = np.append(True, np.diff(furthest) > 0) & (self.station > 0)
        times, stations = np.append(0.0, self.time[ahead]), np.append(0.0, self.station[ahead])
        missing = self.length - stations[-1]
        if 0 < missing <= self.speed[-1] * FINEST:
            times = np.append(times, times[-1] + missing / self.speed[-1])
            stations = np.append(stations, self.length)
        return times, stations


def _left_the_road(name: str, track: Track) -> TrackError:
    return TrackError(f"lap '{name}': it leaves the road of track '{track.name}'; name the track where it was driven")


def _time_at_line(time: Floats, station: Floats, speed: Floats) -> float:
    """When the car was at station 0; where the moments begin after it, by the first one's speed, s."""
    if station[0] > 0:
        return float(time[0] - station[0] / max(speed[0], 1e-9)) if speed[0] >= AT_REST else float(time[0])
    return float(np.interp(0.0, np.maximum.accumulate(station), time))
