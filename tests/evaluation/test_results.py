"""Results of a network on several circuits, figures of many drives, and intervals against numbers worked by hand."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from carrl.errors import ConfigError
from carrl.evaluation.baselines import rule_of, rule_policy
from carrl.evaluation.intervals import mean_interval, rate_interval, share_interval
from carrl.evaluation.results import EvaluationResult, Rollout, aggregate
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.task.action import ContinuousActions
from tests.sim.vehicles import Cart
from tests.worlds import make_world

Z = 1.959964
PEDALS = ContinuousActions(("steer", "pedal"))
NEWER = ("steering_change", "mean_speed", "distance", "speeds", "grip_mean", "grip_greatest", "sector_times")


@dataclass(frozen=True)
class Hovercraft(Cart):
    """A car that is lifted."""

    control_names = ("steer", "lift")


@pytest.fixture(scope="module")
def lap():
    """A complete lap of the oval by the rule."""
    world = make_world("oval")
    (found,) = rollout_laps(world, world.simulator(world.track), rule_policy)
    return found


@pytest.fixture(scope="module")
def crash(lap):
    """A drive that ended at a wall after half as many steps."""
    return replace(lap, lap_completed=False, collided=True, progress=0.5, lap_steps=lap.lap_steps // 2)


def test_a_trial_on_one_track_has_its_drives_own_measures(lap):
    assert EvaluationResult((lap,)).measures() == lap.measures()
    assert EvaluationResult((lap,)).lap_completed


def test_a_lap_counts_when_every_circuit_was_lapped(lap, crash):
    trial = EvaluationResult((lap, crash, lap))
    assert not trial.lap_completed
    measures = trial.measures()
    assert (measures["drives"], measures["laps_completed"]) == (3, 2)
    assert (measures["lap_completed"], measures["collided"]) == (False, True)
    assert measures["progress"] == pytest.approx(2.5 / 3)
    assert trial.shown == 1


@pytest.mark.parametrize("kept", [True, False])
def test_only_the_trajectory_of_the_drive_to_look_at_is_kept(kept, lap, crash):
    trial = EvaluationResult((lap, crash, lap)).with_trajectory(kept)
    assert trial.measures() == EvaluationResult((lap, crash, lap)).measures()
    steps = [len(drive.actions) for drive in trial.rollouts]
    assert steps == [0, len(crash.actions) if kept else 0, 0]
    assert [len(drive.poses) for drive in trial.rollouts] == [0, steps[1] + 1 if kept else 0, 0]
    assert all(array.base is None for drive in trial.rollouts for array in (drive.poses, drive.ranges, drive.actions))
    loaded = EvaluationResult.from_state_dict(trial.state_dict())
    assert loaded.measures() == trial.measures()
    assert (loaded.rollouts[1].ranges == trial.rollouts[1].ranges).all()


def test_of_equally_good_networks_the_fastest_is_the_best(lap):
    assert lap.lap_time is not None
    sectors = tuple(0.9 * sector for sector in lap.sector_times[-1])
    faster = replace(lap, sector_times=(*lap.sector_times[:-1], sectors), forward_share=0.0)
    assert EvaluationResult((faster,)).quality > EvaluationResult((lap,)).quality
    assert EvaluationResult((replace(faster, lap_reward=350.0),)).quality < EvaluationResult((lap,)).quality
    smoother = replace(lap, steering_reward=lap.steering_reward + 1)
    assert EvaluationResult((smoother,)).quality > EvaluationResult((faster,)).quality


def test_more_laps_are_better_than_more_progress(lap, crash):
    hopeless = replace(crash, progress=0.0)
    one_lap, none = EvaluationResult((lap, hopeless)), EvaluationResult((replace(crash, progress=0.9),) * 2)
    assert one_lap.quality > none.quality
    assert EvaluationResult((lap, crash)).quality > one_lap.quality
    assert EvaluationResult((lap,)).quality > EvaluationResult((replace(lap, lap_reward=lap.lap_reward - 20),)).quality


def test_figures_of_drives_are_counts_rates_and_means(lap, crash):
    figures = aggregate([[lap, crash]], step_length=1.0)
    km = (lap.lap_steps + crash.lap_steps) / 1000
    assert (figures["starts"], figures["laps_completed"], figures["collisions"]) == (2, 1, 1)
    assert figures["collisions_per_km"] == pytest.approx(1 / km)
    assert figures["progress"] == 0.75
    low, high = figures["intervals"]["progress"]
    assert (low + high) / 2 == pytest.approx(0.75)
    # Two values that are 0.5 apart: the variance is 0.125, Student's quantile 12.706.
    assert high - low == pytest.approx(2 * 12.7062 * (0.125 / 2) ** 0.5, rel=1e-4)


def test_the_interval_of_several_runs_is_that_of_their_means(lap, crash):
    figures = aggregate([[lap, crash], [lap, crash]], step_length=1.0)
    assert figures["intervals"]["progress"] == (0.75, 0.75)
    assert figures["starts"] == 4


def test_eight_laps_of_eight_say_that_at_least_two_thirds_are_completed():
    assert share_interval(8, 8) == pytest.approx((8 / (8 + Z**2), 1.0))


def test_half_of_ten_is_wilsons_textbook_interval():
    assert share_interval(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def test_no_success_mirrors_no_failure():
    low, high = share_interval(3, 12)
    assert share_interval(9, 12) == pytest.approx((1 - high, 1 - low))
    assert share_interval(0, 0) == (0.0, 1.0)


def test_no_collision_in_10_km_leaves_room_for_a_third_of_one_per_km():
    assert rate_interval(0, 10.0) == pytest.approx((0.0, -math.log(0.025) / 10))


def test_one_collision_has_the_exact_poisson_interval():
    low, high = rate_interval(1, 2.0)
    assert low == pytest.approx(-math.log(0.975) / 2)
    # The probability of at most one event at the upper end is 2.5 %.
    assert math.exp(-2 * high) * (1 + 2 * high) == pytest.approx(0.025)


def test_the_mean_of_three_values_has_students_interval():
    reach = 4.302653 * math.sqrt(1 / 3)  # Student's quantile with 2 degrees of freedom; the variance is 1
    assert mean_interval([1.0, 2.0, 3.0]) == pytest.approx((2 - reach, 2 + reach))


def test_one_value_has_no_interval():
    assert mean_interval([1.0]) is None


# Cars whose speed varies, and actions that are numbers


@pytest.fixture(scope="module")
def pedals_lap():
    """A lap of the paper's track by the rule in a car with pedals that starts at rest."""
    world, policy = rule_of(make_world(vehicle=Kinematic(), sensor=Sensor(rays=9, max_range=30.0), action=PEDALS))
    (found,) = rollout_laps(world, world.simulator(world.track), policy)
    return found


def test_the_rule_laps_with_pedals_and_how_it_drove_is_told_by_speed_and_steering(pedals_lap):
    assert pedals_lap.lap_completed and not pedals_lap.collided
    ways = np.linalg.norm(np.diff(pedals_lap.poses[:, :2].astype(float), axis=0), axis=1)
    assert pedals_lap.distance == pytest.approx(ways.sum())
    assert pedals_lap.mean_speed == pytest.approx(ways.sum() / (0.1 * pedals_lap.lap_steps))
    speeds = pedals_lap.speeds.astype(float)
    assert speeds[0] == 0 and ways == pytest.approx(0.05 * (speeds[1:] + speeds[:-1]), rel=0.01)
    assert pedals_lap.steering_change == pytest.approx(np.abs(np.diff(pedals_lap.actions[:, 0])).mean(), rel=1e-5)
    assert not {"forward_share", "switches_per_100m", "reversals"} & pedals_lap.measures().keys()
    figures = aggregate([[pedals_lap]], step_length=2.0)
    assert figures["driven_km"] == pytest.approx(ways.sum() / 1000)
    assert (figures["mean_speed"], "forward_share" in figures) == (pedals_lap.mean_speed, False)


def test_of_two_laps_with_pedals_the_faster_one_is_better_and_a_lap_better_than_none(pedals_lap):
    seconds = tuple(tuple(2 * sector for sector in sectors) for sectors in pedals_lap.sector_times)
    slower = replace(pedals_lap, mean_speed=pedals_lap.mean_speed / 2, sector_times=seconds, lap_reward=1e6)
    crash = replace(pedals_lap, lap_completed=False, progress=0.9, mean_speed=99.0)
    qualities = [EvaluationResult((drive,)).quality for drive in (crash, slower, pedals_lap)]
    assert qualities == sorted(qualities) and qualities[1] < qualities[2]


def test_a_drive_with_speeds_comes_back_from_its_state_and_one_of_an_older_version_too(pedals_lap, lap):
    back = Rollout.from_state_dict(pedals_lap.state_dict())
    assert back.measures() == pedals_lap.measures() and (back.speeds == pedals_lap.speeds).all()
    old = {name: value for name, value in lap.state_dict().items() if name not in NEWER}
    assert Rollout.from_state_dict(old).measures() == lap.measures() | {"lap_time": None}
    assert (lap.mean_speed, lap.distance, lap.steering_change, lap.speeds) == (None,) * 4


def test_a_car_that_stands_still_has_no_collisions_and_no_infinite_rate():
    world = make_world(vehicle=Cart(), action=PEDALS)
    (stands,) = rollout_laps(world, world.simulator(world.track), lambda seen: torch.tensor([[0.0, -1.0]] * len(seen)))
    assert (stands.progress, stands.mean_speed, stands.distance) == (0.0, 0.0, 0.0)
    assert aggregate([[stands]], 2.0)["collisions_per_km"] == 0


def test_a_car_that_the_rule_does_not_know_is_refused():
    world = make_world(vehicle=Hovercraft(), action=ContinuousActions(("steer", "lift")))
    with pytest.raises(ConfigError, match=r"the rule drives cars with steer, or with a speed and some of .*Hovercraft"):
        rule_of(world)


@pytest.mark.parametrize(("push", "throttle", "brake"), [(1.0, 1, -1), (0.5, 0, -1), (-1.0, -1, 1), (0.0, -1, -1)])
def test_the_rule_pushes_two_pedals_as_it_does_one(push, throttle, brake):
    from carrl.evaluation.baselines import _PEDALS

    pressed = {name: function(torch.tensor(push)).item() for name, function in _PEDALS.items()}
    assert pressed == {"pedal": push, "throttle": throttle, "brake": brake}


def test_a_flying_lap_is_the_last_of_several_and_faster_than_one_from_rest(pedals_lap):
    world, policy = rule_of(make_world(vehicle=Kinematic(), sensor=Sensor(rays=9, max_range=30.0), action=PEDALS))
    (flying,) = rollout_laps(world, world.simulator(world.track), policy, laps=2)
    assert flying.lap_completed and flying.progress == 1 and flying.speeds[0] > 5
    assert flying.lap_steps < pedals_lap.lap_steps
    begin = flying.poses[0, :2]
    assert np.linalg.norm(begin - pedals_lap.poses[-1, :2]) < 1e-6  # where the first lap ended
    (third,) = rollout_laps(world, world.simulator(world.track), policy, laps=3)
    assert third.distance == pytest.approx(flying.distance, rel=0.01)


def test_a_drive_that_ends_in_its_first_lap_is_measured_from_its_start():
    world = make_world("oval")
    straight_on = rollout_laps(world, world.simulator(world.track), lambda seen: torch.zeros(len(seen), dtype=int))
    (crash,) = rollout_laps(
        world, world.simulator(world.track), lambda seen: torch.zeros(len(seen), dtype=torch.int64), laps=2
    )
    assert crash.collided and not crash.lap_completed
    assert (crash.lap_steps, crash.lap_reward) == (straight_on[0].lap_steps, straight_on[0].lap_reward)
    assert crash.progress == pytest.approx(straight_on[0].progress / 2, abs=0.1)


@pytest.mark.parametrize("laps", [0, -1, 1.5])
def test_laps_that_cannot_be_driven_are_refused(laps):
    world = make_world("oval")
    with pytest.raises(ConfigError, match=f"laps is {laps}"):
        rollout_laps(world, world.simulator(world.track), rule_policy, laps=laps)
