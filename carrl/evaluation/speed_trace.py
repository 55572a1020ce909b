"""How fast cars were where: a row for each moment of a drive, as racers read it against the way along the road."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from carrl.errors import ConfigError
from carrl.evaluation.results import Rollout
from carrl.sim.places import stations_along
from carrl.sim.vehicle import VehicleModel
from carrl.tracks.track import Track

Cell: TypeAlias = str | int | float
HEADER = ("driver", "track", "start_m", "time_s", "station_m", "x_m", "y_m", "heading_rad", "speed_m_s")


@dataclass(frozen=True)
class TracedDrive:
    """A drive with its trajectory.

    Attributes:
        driver: who drove it, in a word.
        track: where.
        drive: with its trajectory.
    """

    driver: str
    track: Track
    drive: Rollout


def traced_drives(
    drivers: Sequence[str], tracks: Sequence[Track], runs: Sequence[Sequence[Sequence[Rollout]]]
) -> Iterator[TracedDrive]:
    """The drives of each driver on each track."""
    for driver, of_tracks in zip(drivers, runs, strict=True):
        for track, drives in zip(tracks, of_tracks, strict=True):
            yield from (TracedDrive(driver, track, drive) for drive in drives)


def speed_table(drives: Iterable[TracedDrive], vehicle: VehicleModel) -> str:
    """The lap measured of each drive as CSV; `station_m` is along the centreline from the track's start line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for each in drives:
        writer.writerows(_rows(each, vehicle))
    return text.getvalue()


def read_speed_table(text: str, name: str) -> dict[tuple[str, str, float], NDArray[np.float64]]:
    """The laps in a table that `speed_table` wrote.

    Args:
        text: of the table.
        name: of it, with which the sentence about a fault begins.

    Returns:
        Of each driver, track and start, m, the time, place, heading and speed of every moment, [T, 5], s, m, m, rad,
        m/s.

    Raises:
        ConfigError: a row is not one of such a table.
    """
    laps: dict[tuple[str, str, float], list[list[float]]] = {}
    for number, row in enumerate(csv.reader(io.StringIO(text)), start=1):
        if number == 1:
            continue
        try:
            driver, track, start, time, _, *motion = row
            moment = [float(time), *map(float, motion)]
            known = laps.setdefault((driver, track, float(start)), [])
        except ValueError:
            moment, known = [], []
        if len(moment) != len(HEADER) - 4 or not np.isfinite(moment).all():
            raise ConfigError(f"{name}: row {number} is {','.join(row)[:60]!r}; it must be {','.join(HEADER)}")
        if known and moment[0] <= known[-1][0]:
            raise ConfigError(f"{name}: row {number} is at {moment[0]:g} s; time must grow within a lap")
        known.append(moment)
    return {key: np.array(moments) for key, moments in laps.items()}


def _rows(traced: TracedDrive, vehicle: VehicleModel) -> Iterator[Sequence[Cell]]:
    drive = traced.drive
    stations, _ = stations_along(traced.track, torch.from_numpy(drive.poses), drive.start, vehicle.step_length)
    known: list[Cell] = [traced.driver, traced.track.name, round(drive.start, 3)]
    for step, (pose, station) in enumerate(zip(drive.poses.tolist(), stations.tolist(), strict=True)):
        speed = vehicle.step_length / vehicle.time_step if drive.speeds is None else float(drive.speeds[step])
        figures: list[float] = [step * vehicle.time_step, station, *pose, speed]
        yield *known, *(round(figure, 4) for figure in figures)
