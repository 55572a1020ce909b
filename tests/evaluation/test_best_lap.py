"""The best lap that the search finds, against every possible lap of a tiny track and against the rule."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from carrl.errors import ConfigError, TrackError
from carrl.evaluation import best_lap
from carrl.evaluation.baselines import rule_policy
from carrl.evaluation.best_lap import find_best_lap
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.vehicle import Vehicle
from carrl.task.action import ContinuousActions, DiscreteActions
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track
from tests.sim.steering import ACTIONS, FORWARD, LEFT, RIGHT, steer
from tests.worlds import make_world

LEFT_OR_RIGHT = {LEFT, RIGHT}


def clover(width=10.0):
    """A ring with three lobes, and a car with steps so long, 7 m and 35 degrees, that 20 make a lap."""
    angle = np.arange(36) * 2 * math.pi / 36
    radius = 20 * (1 + 0.25 * np.cos(3 * angle))
    points = np.stack([radius * np.sin(angle), -radius * np.cos(angle)], axis=1)
    half = np.full(36, width / 2)
    track = Track.from_centreline("clover", Centreline(points, half, half), gate_count=4)
    return make_world(track, vehicle=Vehicle(speed=7.0, time_step=1.0, turn_radius=7 / math.radians(35)))


@pytest.fixture(scope="module")
def clean_laps():
    """The actions of every clean lap of the clover, found by driving all sequences of actions as far as they go."""
    world, laps = clover(), []
    simulator = world.simulator(world.track)
    drives, cars = [()], simulator.start(torch.zeros(1))
    while drives:
        drives = [(*actions, action) for actions in drives for action in ACTIONS]
        last = torch.tensor([actions[-1] for actions in drives])
        repeated = cars.map(lambda values: values.repeat_interleave(3, dim=0))
        outcome = simulator.step(repeated, steer(last))
        cars = outcome.cars
        clean = ~outcome.collided & ~world.reward.near_wall.is_near_wall(outcome.ranges / world.sensor.max_range)
        done = cars.gates_passed >= simulator.track.gate_count
        laps += [drives[i] for i in (clean & done).nonzero()[:, 0]]
        going = (clean & ~done).nonzero()[:, 0]
        drives, cars = [drives[i] for i in going], cars[going]
    return laps


def counts(actions):
    """Turns, switches and steps."""
    turns = sum(action != FORWARD for action in actions)
    return turns, sum(a != b for a, b in pairwise(actions)), len(actions)


def goes_directly_from_side_to_side(actions):
    return any({a, b} == LEFT_OR_RIGHT for a, b in pairwise(actions))


def test_no_clean_lap_of_a_tiny_track_is_better(clean_laps):
    best = find_best_lap(clover(), bin_size=0.01)
    assert counts(best.actions) == min(map(counts, clean_laps)) == (11, 8, 20)
    assert tuple(best.actions) in clean_laps
    assert goes_directly_from_side_to_side(best.actions)


def test_forgetting_places_costs_nothing_but_time(monkeypatch):
    monkeypatch.setattr(best_lap, "_MEMORY_SLOTS", 5)
    assert counts(find_best_lap(clover(), bin_size=0.01).actions) == (11, 8, 20)


def test_the_best_lap_of_the_oval_is_clean_and_turns_little_more_than_once_round():
    world = make_world("oval")
    best = find_best_lap(world, bin_size=0.7)
    assert best.lap_completed and not best.collided and best.near_wall_share == 0
    assert best.lap_reward == 8 * 50
    turns, switches, _ = counts(best.actions)
    turned = np.unwrap(best.poses[:, 2])
    assert turns >= round(abs(turned[-1] - turned[0]) / world.vehicle.yaw_per_step)
    assert 2 * math.pi - math.radians(20) < turns * world.vehicle.yaw_per_step < 2 * math.pi + math.radians(20)
    (rule,) = rollout_laps(world, world.simulator(world.track), rule_policy)
    assert rule.lap_completed and rule.near_wall_share == 0
    assert (turns, switches) < counts(rule.actions)[:2]


def test_a_track_too_narrow_for_a_clean_lap_is_named():
    with pytest.raises(TrackError, match="track 'clover': found no lap without a collision or a step near a wall"):
        find_best_lap(clover(width=2.5), bin_size=0.5)


@pytest.mark.parametrize("bin_size", [0.0, -1.0, math.nan, 0.8])
def test_a_square_that_a_step_may_not_leave_is_refused(bin_size):
    with pytest.raises(ConfigError, match=r"bin_size is .*; it must be positive and at most 0\.707 m"):
        find_best_lap(make_world("oval"), bin_size=bin_size)


@pytest.mark.parametrize(
    "parts",
    [
        {"action": ContinuousActions(("steer",))},
        {"action": DiscreteActions(("forward", "half_left", "right"), {"steer": (0.0, 0.5, -1.0)})},
    ],
    ids=["continuous", "half a turn"],
)
def test_a_car_that_steers_otherwise_is_refused(parts):
    with pytest.raises(ConfigError, match="among full left, straight on and full right at a constant speed"):
        find_best_lap(make_world("oval", **parts))
