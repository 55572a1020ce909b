"""Opponents that follow the line of a minimum lap instead of the centreline."""

import numpy as np
import pytest
import torch

from carrl import ContinuousActions, Start, TrackEnv
from carrl.errors import ConfigError, TrackError
from carrl.opponents.line import LineOpponents
from carrl.sim.single_track import SingleTrack
from tests.racing.laps import oval_lap

pytest.importorskip("casadi", reason="minimum laps need pip install 'carrl[racing]'")
DRIVEN = {"vehicle": SingleTrack(), "action": ContinuousActions()}
PACE = 0.9


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    path = tmp_path_factory.mktemp("line") / "oval.csv"
    oval_lap().line.write(path)
    return path


def alone(path, **options):
    """The drive of one opponent whose learner is nowhere, after it has come up to its speed: [T, S]."""
    opponents = LineOpponents(pace=PACE, spread=0.0, offset=0.0, line=str(path))
    env = TrackEnv("oval", seed=0, cars_per_world=2, opponents=opponents, **DRIVEN, **options)
    cars = env.task.start().state.cars
    cars.state.fill_(torch.nan)
    states = []
    for _ in range(300):
        cars.others = opponents.drive(env.simulator, cars)
        states.append(cars.others.state[0, 0].double().numpy())
    return np.array(states[100:])


def test_they_follow_the_line_at_a_share_of_its_speed(line):
    """As near as lanes come to walls, of which a minimum lap touches some: half of half a car's width."""
    lap, car, driven = oval_lap().line, SingleTrack(), alone(line)
    apart = np.linalg.norm(driven[:, None, :2] - lap.places, axis=-1)
    nearest = apart.argmin(axis=1)
    assert apart.min(axis=1).max() < np.diff(lap.distance).max() / 2 + car.width / 4 + 0.1
    assert driven[:, 3] == pytest.approx(PACE * lap.speed[nearest], rel=0.1)
    course = (lap.heading + lap.slip)[nearest]
    assert np.abs(np.angle(np.exp(1j * (driven[:, 2] - course)))).max() < 0.15
    way = np.linalg.norm(np.diff(driven[:, :2], axis=0), axis=1)
    assert way == pytest.approx(driven[1:, 3] * car.time_step, rel=0.1)  # the centreline is a polygon
    assert way.sum() == pytest.approx(driven[1:, 3].sum() * car.time_step, rel=5e-3)


@pytest.mark.parametrize(
    ("track", "start", "error", "says"),
    [
        ("paper", Start(), TrackError, r"opponents\.line: 'oval\.csv' is no line of track 'paper'"),
        (["oval", "oval"], Start(), ConfigError, r"opponents\.line is of one road, and there are 2"),
        ("oval", Start(mirrored=True), ConfigError, r"opponents\.line is of one road, and there are 2"),
    ],
)
def test_a_line_of_another_road_is_refused(track, start, error, says, line):
    with pytest.raises(error, match=says):
        TrackEnv(track, cars_per_world=2, opponents=LineOpponents(line=str(line)), start=start, **DRIVEN)


def test_a_line_that_is_no_file_is_refused(tmp_path):
    with pytest.raises(
        TrackError, match=r"^opponents\.line is '.*none\.csv', and line 'none\.csv'.* --csv writes one$"
    ):
        TrackEnv("oval", cars_per_world=2, opponents=LineOpponents(line=str(tmp_path / "none.csv")), **DRIVEN)
    with pytest.raises(ConfigError, match=r"opponents\.line is 3; it must be a str"):
        LineOpponents(line=3)
