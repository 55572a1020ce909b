"""How fast cars were where: a row for each moment of a drive, as racers read it against the way along the road."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch

from carrl.evaluation.results import Rollout
from carrl.sim.places import Places
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


def _rows(traced: TracedDrive, vehicle: VehicleModel) -> Iterator[Sequence[Cell]]:
    drive = traced.drive
    known: list[Cell] = [traced.driver, traced.track.name, round(drive.start, 3)]
    for step, (pose, station) in enumerate(zip(drive.poses.tolist(), _stations(traced, vehicle), strict=True)):
        speed = vehicle.step_length / vehicle.time_step if drive.speeds is None else float(drive.speeds[step])
        figures: list[float] = [step * vehicle.time_step, station, *pose, speed]
        yield *known, *(round(figure, 4) for figure in figures)


def _stations(traced: TracedDrive, vehicle: VehicleModel) -> list[float]:
    """Where along the road each moment was, m: each is looked for near the one before, as a road may cross itself."""
    track, poses = traced.track, torch.from_numpy(traced.drive.poses)
    places, only = Places([track.road], [track.gate_count], vehicle.step_length), torch.zeros(1, dtype=torch.int64)
    next_gate = track.next_gate(torch.tensor([traced.drive.start]))
    station, stations = places.on_the_way(poses[:1], only, next_gate).station, []
    for pose in poses:
        station = places.after(pose[None], only, station).station
        stations.append(station.item())
    return stations
