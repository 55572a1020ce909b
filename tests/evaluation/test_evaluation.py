"""Driving without exploration, and the measures of it."""

import math

import pytest
import torch

from carrl import Sensor, Track, TrackEnv, Vehicle
from carrl.errors import ConfigError
from carrl.evaluation.baselines import random_policy, rule_policy
from carrl.evaluation.results import aggregate
from carrl.evaluation.rollout import rollout, rollout_laps
from carrl.sim.kinematic import Kinematic
from carrl.sim.simulator import Simulator
from carrl.task.action import ContinuousActions
from carrl.task.reward import Gate, Reward
from tests.worlds import make_world

WORLD = make_world()


def make_simulator(track="paper", **vehicle):
    return Simulator(Track.load(track), Vehicle(**vehicle), Sensor(max_range=10.0))


def forward_policy(observation):
    return torch.zeros(len(observation), dtype=torch.int64)


def left_policy(observation):
    return torch.ones(len(observation), dtype=torch.int64)


def zig_zag_policy():
    """Left and right in turn: straight on average."""
    step = 0

    def act(observation):
        nonlocal step
        step += 1
        return torch.full((len(observation),), 1 + step % 2)

    return act


@pytest.mark.parametrize("track", ["oval", "paper", "serpentine"])
def test_the_rule_laps_every_built_in_track_from_everywhere(track):
    drives = rollout_laps(WORLD, make_simulator(track), rule_policy, starts=4)
    assert all(attempt.lap_completed and not attempt.collided for attempt in drives)
    assert all(attempt.progress == 1.0 for attempt in drives)


def test_a_clean_lap_earns_50_for_each_gate():
    (attempt,) = rollout_laps(WORLD, make_simulator("oval"), rule_policy)
    assert attempt.near_wall_share == 0
    assert attempt.lap_reward == 8 * 50


def test_only_a_reward_that_knows_what_is_near_a_wall_has_a_share_of_such_steps():
    world = make_world("oval", reward=Reward({"gate": Gate()}))
    (attempt,) = rollout_laps(world, world.simulator(world.track), rule_policy)
    assert attempt.near_wall_share is None
    assert "near_wall_share" not in attempt.measures()
    assert "near_wall_share" not in aggregate([[attempt]], step_length=1.0)


def test_the_measures_agree_with_the_environments_own_rewards():
    simulator = make_simulator()
    (attempt,) = rollout_laps(WORLD, simulator, rule_policy)
    env = TrackEnv(sensor=Sensor(max_range=10.0))
    state = env.reset()
    total = 0.0
    for action in attempt.actions:
        transition, state = env.step_and_maybe_reset(state.set("action", torch.tensor([action])))
        total += transition["next", "reward"].item()
    assert attempt.lap_reward == pytest.approx(total)
    torch.testing.assert_close(torch.from_numpy(attempt.poses[-1]), transition["next", "pose"][0])


def test_a_car_that_never_steers_crashes_at_the_first_turn():
    (attempt,) = rollout_laps(WORLD, make_simulator(), forward_policy)
    assert attempt.collided and not attempt.lap_completed
    assert attempt.lap_reward <= -200 + 50
    assert 0.05 < attempt.progress < 0.25
    assert (attempt.forward_share, attempt.switches_per_100m) == (1.0, 0.0)
    assert len(attempt.poses) == len(attempt.ranges) == attempt.lap_steps + 1 == len(attempt.actions) + 1


def test_zig_zag_is_counted_as_switches():
    (attempt,) = rollout_laps(WORLD, make_simulator(), zig_zag_policy())
    assert attempt.forward_share == 0
    steps = attempt.lap_steps
    assert attempt.switches_per_100m == pytest.approx(100 * (steps - 1) / steps)
    assert attempt.reversals == steps - 1


def test_a_car_that_circles_is_stopped_by_the_time_limit():
    simulator = make_simulator("oval", turn_radius=2.0)
    (attempt,) = rollout_laps(WORLD, simulator, left_policy)
    assert not attempt.collided and not attempt.lap_completed
    assert attempt.lap_steps == 2 * simulator.lap_steps
    assert attempt.progress < 0.05


def test_cars_driven_together_drive_as_they_would_alone():
    simulator = make_simulator()
    together = rollout_laps(WORLD, simulator, rule_policy, starts=5)
    assert [attempt.start for attempt in together] == pytest.approx([k * simulator.track.length / 5 for k in range(5)])
    (first,) = rollout_laps(WORLD, simulator, rule_policy)
    assert together[0].measures() == first.measures()


def test_the_random_policy_repeats_itself_for_the_same_seed():
    first, second = (rollout_laps(WORLD, make_simulator(), random_policy(3, WORLD.action))[0] for _ in range(2))
    assert first.measures() == second.measures()


def test_no_start_place_is_refused():
    with pytest.raises(ConfigError, match="starts is 0"):
        rollout_laps(WORLD, make_simulator(), rule_policy, starts=0)


def test_several_tracks_driven_together_are_driven_as_each_alone():
    names = ("oval", "serpentine", "paper")
    together = Simulator([Track.load(name) for name in names], Vehicle(), Sensor(max_range=10.0))
    drives = rollout_laps(WORLD, together, rule_policy, starts=2)
    alone = [attempt for name in names for attempt in rollout_laps(WORLD, make_simulator(name), rule_policy, starts=2)]
    assert [attempt.measures() for attempt in drives] == [attempt.measures() for attempt in alone]


def test_each_car_has_the_time_limit_of_its_own_track():
    tracks = [Track.load("oval"), Track.load("serpentine")]
    simulator = Simulator(tracks, Vehicle(turn_radius=1.0), Sensor(max_range=10.0))
    drives = rollout_laps(WORLD, simulator, left_policy)
    assert [attempt.lap_steps for attempt in drives] == [2 * math.ceil(track.length) for track in tracks]


def test_a_start_that_is_no_number_is_refused():
    with pytest.raises(ConfigError, match=r"stations are \[0\.0, nan\]; they must be finite numbers of metres"):
        rollout(WORLD, make_simulator(), rule_policy, torch.tensor([0.0, math.nan]))


# Cars with a speed of their own


def pedal_policy(pedal):
    """Steers to the side with more room, with the pedal that a function of the step says."""
    step = 0

    def act(seen):
        nonlocal step
        step += 1
        turn = (seen[:, 4:7].sum(1) - seen[:, :3].sum(1)) / seen[:, :7].sum(1)
        return torch.stack([(3 * turn).clamp(-1, 1), torch.full_like(turn, pedal(step))], dim=1)

    return act


def race(pedal, **vehicle):
    actions = ContinuousActions(("steer", "pedal"))
    world = make_world("oval", vehicle=Kinematic(**vehicle), action=actions)
    (driven,) = rollout_laps(world, world.simulator(world.track), pedal_policy(pedal))
    return driven, world


def test_a_car_that_never_drives_off_is_stopped_long_before_a_lap_could_take():
    driven, world = race(lambda step: 0.0)
    gap = world.track.length / world.track.gate_count
    assert driven.lap_steps == math.ceil(10 * gap / (50.8 * 0.1) + 10 / 0.1)
    assert (driven.lap_completed, driven.collided, driven.progress) == (False, False, 0)


def test_a_car_that_stops_on_its_way_is_stopped_as_long_after_its_last_gate():
    driven, world = race(lambda step: 0.5 if step < 60 else -1.0)
    gap = world.track.length / world.track.gate_count
    patience = math.ceil(10 * gap / (50.8 * 0.1) + 10 / 0.1)
    assert patience < driven.lap_steps < patience + 60
    assert 0 < driven.progress < 0.5


def test_a_slow_car_may_finish_its_lap():
    """At a sixth of full speed, where a car of one speed may take two laps' time."""
    driven, world = race(lambda step: 0.5 if step < 10 else 0.0, max_acceleration=4.0, max_speed=12.0)
    assert driven.lap_completed
    assert driven.lap_steps > 5 * world.track.length / (12.0 * 0.1)
