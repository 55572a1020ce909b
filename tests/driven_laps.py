"""Laps along the middle of a road whose times can be worked out by hand, and their files."""

import csv

import numpy as np
import torch

from carrl.evaluation.speed_trace import HEADER
from carrl.racing.laps import Lap
from carrl.tracks.track import Track


def moments(track: Track, stations, speeds, step: float = 0.1):
    """Times, poses and speeds of a car that is at these stations, m, one time step after the other."""
    stations = np.asarray(stations, dtype=np.float64)
    poses = track.pose_at(torch.from_numpy(stations) % track.length).double().numpy()
    return np.arange(len(stations)) * step, poses, np.broadcast_to(np.asarray(speeds, dtype=float), stations.shape)


def steady(track: Track, speed: float, begin: float = 0.0, end: float = np.inf, step: float = 0.1):
    """The moments of a lap at a speed, m/s, from a station to the first moment after a lap, or to another station."""
    count = int(np.ceil((min(track.length, end) - begin) / (speed * step))) + 1
    stations = begin + np.arange(count) * speed * step
    return moments(track, stations[stations <= end], speed, step)


def steady_lap(track: Track, speed: float, name: str = "lap", **where: float) -> Lap:
    """That lap."""
    return Lap.of(name, track, *steady(track, speed, **where))


def write_trace(path, track: Track, laps, driver: str = "seed 0", start: float = 0.0):
    """Writes moments, or those of several drivers by their names, as `carrl evaluate --speed-trace` does."""
    laps = laps if isinstance(laps, dict) else {driver: laps}
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for name, (times, poses, speeds) in laps.items():
            for time, pose, speed in zip(times, poses.tolist(), speeds, strict=True):
                writer.writerow([name, track.name, start, round(time, 4), 0.0, *(round(x, 4) for x in (*pose, speed))])
    return path
