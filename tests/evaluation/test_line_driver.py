"""The driver that follows a line: no faster than the limit, and near it; and how it turns the wheels."""

import pytest
import torch

from carrl.errors import ConfigError
from carrl.evaluation.baselines import rule_of
from carrl.evaluation.line_driver import LineDriver, Sight, careful_line, line_driver_of
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.kinematic import Kinematic
from carrl.sim.single_track import SingleTrack
from carrl.sim.vehicle import Vehicle
from carrl.task.action import ContinuousActions
from carrl.tracks.track import Track
from tests.racing.laps import oval_lap
from tests.worlds import make_world

OVAL = Track.load("oval")


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def flying_laps(car, driver, starts=4):
    """The times of flying laps of the oval from several places, s; None of those that do not count."""
    world = make_world(OVAL, vehicle=car, action=ContinuousActions(car.control_names))
    seen, policy = driver(world)
    return [drive.lap_time for drive in rollout_laps(seen, world.simulator(OVAL), policy, starts, laps=2)]


def follow(world):
    return line_driver_of(world, [OVAL])


def test_no_driver_is_faster_than_the_limit_and_the_line_comes_near_it():
    limit, car = oval_lap().lap_time, SingleTrack()
    line, rule = flying_laps(car, follow), flying_laps(car, rule_of)
    assert len(line) == len(rule) == 4 and None not in line + rule
    assert min(line + rule) > 0.997 * limit
    assert max(line) < 1.25 * limit < min(rule)
    assert max(line) < 1.03 * careful_line(OVAL, car).lap_time


@pytest.mark.parametrize(
    "car",
    [SingleTrack(pedals="two"), SingleTrack(pedals="power"), SingleTrack(steering="rate"), SingleTrack(time_step=0.05)],
    ids=["two pedals", "power", "steering rate", "shorter steps"],
)
def test_cars_that_are_controlled_otherwise_lap_too(car):
    assert None not in flying_laps(car, follow, starts=2)


@pytest.mark.parametrize(("speed", "curvature"), [(20.0, 0.012), (35.0, -0.005), (45.0, 0.002)])
def test_the_wheels_turn_for_the_curvature_of_the_line_by_the_slip_of_the_tyres(speed, curvature):
    car = SingleTrack()
    state = car.initial_state(torch.zeros(1, 3), torch.tensor([speed]))
    names = car.state_names
    driver = LineDriver(car)
    for _ in range(60):
        now = {name: state[:, index] for index, name in enumerate(names)}
        nothing = torch.zeros(1)
        sight = Sight(
            nothing,
            nothing,
            now["speed"],
            now["speed"] * curvature,  # no damping: the feedforward alone
            now["steering"],
            torch.full((1,), curvature),
            torch.full((1,), speed),
            nothing,
        )
        state = car.step(state, driver(torch.stack(sight, dim=-1)))
    driven = state[0, names.index("yaw_rate")] / state[0, names.index("speed")]
    assert driven.item() == pytest.approx(curvature, rel=0.03)


def test_a_car_beside_the_line_steers_back_to_it_and_one_that_is_slow_speeds_up():
    see = dict.fromkeys(Sight._fields, torch.zeros(3)) | {
        "offset": torch.tensor([2.0, -2.0, 0.0]),
        "speed": torch.tensor([20.0, 20.0, 25.0]),
        "pace": torch.full((3,), 22.0),
    }
    wheel, pedal = LineDriver(SingleTrack())(torch.stack(Sight(**see), dim=-1)).T
    assert wheel[0] < 0 < wheel[1] and wheel[2] == 0
    assert pedal[0] > 0 > pedal[2]


@pytest.mark.parametrize("car", [Vehicle(), Kinematic(), SingleTrack("commonroad_2"), SingleTrack("f1tenth")])
def test_other_cars_are_refused_in_a_sentence(car):
    world = make_world(OVAL, vehicle=car, action=ContinuousActions(car.control_names))
    with pytest.raises(ConfigError, match="the line is driven by a car with brush tyres"):
        follow(world)
