"""A road and a lap that several tests look at."""

from functools import cache

import numpy as np

from carrl.racing.minimum_lap import MinimumLap, minimum_lap
from carrl.sim.single_track import SingleTrack
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track

SPACING = 2.5
RADIUS, HALF = 40.0, 5.0


def ring(points: int = 200) -> Track:
    """A round road driven to the left, 10 m wide."""
    angle = np.arange(points) * 2 * np.pi / points
    line = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Track.from_centreline("ring", Centreline(line, np.full(points, HALF), np.full(points, HALF)))


@cache
def oval_lap() -> MinimumLap:
    """That of the default car, on a grid of 2.5 m."""
    return minimum_lap(Track.load("oval"), SingleTrack(), SPACING)
