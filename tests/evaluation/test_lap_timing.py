"""Lap times: exact on a circle, the same whatever the time step, of whole laps wherever a drive begins."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from carrl import Track
from carrl.errors import ConfigError
from carrl.evaluation.baselines import rule_of, rule_policy
from carrl.evaluation.document import checked_limits, lap_figures
from carrl.evaluation.lap_files import read_laps
from carrl.evaluation.lap_timing import LapTiming
from carrl.evaluation.results import EvaluationResult, aggregate
from carrl.evaluation.rollout import _grip, rollout, rollout_laps
from carrl.evaluation.speed_trace import HEADER, TracedDrive, speed_table
from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Bicycle
from carrl.task.action import ContinuousActions
from carrl.tracks.centreline import Centreline
from tests.worlds import make_world

RADIUS = 20.0
GATES = 7
"""No multiple of the sectors, so that lines and gates stand in different places."""


@pytest.fixture(scope="module")
def circle():
    """A road of 8 m about a circle, driven counter-clockwise from (20, 0)."""
    angle = np.arange(720) * 2 * math.pi / 720
    points = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Track.from_centreline("circle", Centreline(points, np.full(720, 4.0), np.full(720, 4.0)), gate_count=GATES)


def left(seen):
    return torch.ones(len(seen), dtype=torch.int64)


def bicycle(time_step):
    """A car at 10 m/s on exact arcs of 20 m: half of its wheelbase of 1 m over the sine of the slip of its middle."""
    slip = math.asin(0.5 / RADIUS)
    return Bicycle(speed=10.0, time_step=time_step, steering_angle=math.degrees(math.atan(2 * math.tan(slip))))


@pytest.mark.parametrize("time_step", [0.1, 0.01])
@pytest.mark.parametrize("station", [0.0, 40.0])
def test_a_lap_of_a_circle_at_constant_speed_takes_its_length_over_the_speed(circle, time_step, station):
    """2 pi 20 m / 10 m/s = 12.566 s, which is no multiple of a step."""
    world = make_world(circle, vehicle=bicycle(time_step))
    (driven,) = rollout(world, world.simulator(circle), left, torch.tensor([station]), laps=2)
    assert driven.lap_completed
    # In float32 a heading that turns by 0.005 rad a step is some 2e-5 of a lap off after 1,257 steps; time is not.
    assert driven.lap_times == pytest.approx([4 * math.pi, 4 * math.pi], abs=1e-4 if time_step == 0.1 else 5e-4)
    assert driven.lap_time == driven.lap_times[1]
    for sectors in driven.sector_times:  # the arc is not about the middle of the road, but near it
        assert sectors == pytest.approx([4 * math.pi / 3] * 3, abs=0.1)


@pytest.mark.parametrize("time_step", [0.1, 0.01])
def test_a_car_that_speeds_up_evenly_from_rest_has_the_times_of_that(circle, time_step):
    """With 4 m/s^2 it comes as far as s in sqrt(s / 2): a lap of 125.66 m takes 7.927 s, its second one 3.283 s."""
    acceleration, steps = 4.0, round(13.0 / time_step)
    simulator = Simulator(circle, Kinematic(time_step=time_step), Sensor())
    time = torch.arange(steps + 1, dtype=torch.float64) * time_step
    angle = acceleration * time**2 / 2 / RADIUS
    state = torch.zeros(steps + 1, 1, 9)
    state[:, 0, 0], state[:, 0, 1] = RADIUS * angle.cos(), RADIUS * angle.sin()
    state[:, 0, 3] = acceleration * time
    passed = (angle / (2 * math.pi / GATES)).long()[:, None]
    cars = simulator.start(torch.zeros(1, dtype=torch.float64))
    course = CarState(state, passed % GATES, passed, torch.zeros_like(passed))
    (laps,) = LapTiming(simulator, cars, torch.zeros(1), 2).sector_times(course, torch.tensor([steps]))
    at_lines = [math.sqrt(third * 2 * math.pi * RADIUS / 3 * 2 / acceleration) for third in range(7)]
    assert np.concatenate(laps) == pytest.approx([end - begin for begin, end in pairwise(at_lines)], abs=1e-4)
    assert [sum(sectors) for sectors in laps] == pytest.approx([7.927, 3.283], abs=1e-3)


@pytest.fixture(scope="module")
def pedals():
    """A car with pedals that the rule drives round the oval, and the rule."""
    action, sensor = ContinuousActions(("steer", "pedal")), Sensor(rays=9, max_range=30.0)
    return rule_of(make_world("oval", vehicle=Kinematic(), sensor=sensor, action=action))


def test_wherever_a_drive_begins_its_lap_is_a_whole_one():
    """These starts stand two thirds and a third of the way between two gates."""
    world = make_world("oval")
    drives = rollout_laps(world, world.simulator(world.track), rule_policy, starts=3)
    assert [drive.lap_time for drive in drives] == pytest.approx([21.03] * 3, abs=0.02)
    assert [drive.lap_steps for drive in drives[1:]] == pytest.approx([194, 202], abs=2)  # from the start to a gate


def test_the_first_lap_of_a_car_with_pedals_is_a_standing_one_and_the_slowest(pedals):
    world, policy = pedals
    (driven,) = rollout_laps(world, world.simulator(world.track), policy, laps=3)
    standing, second, third = driven.laps()
    assert [lap["start"] for lap in (standing, second, third)] == ["standing", "flying", "flying"]
    assert standing["time_s"] > second["time_s"] + 1
    assert second["time_s"] == pytest.approx(third["time_s"], abs=0.05)
    assert third["time_s"] == round(driven.lap_time, 3) == driven.measures()["lap_time"]
    for lap in (standing, second, third):
        assert sum(lap["sectors_s"]) == pytest.approx(lap["time_s"], abs=2e-3)


def test_lap_times_of_cars_driven_together_are_those_of_each_alone(pedals):
    world, policy = pedals
    simulator = world.simulator(world.track)
    together = rollout_laps(world, simulator, policy, starts=3, laps=2)
    for drive in together:
        (alone,) = rollout(world, simulator, policy, torch.tensor([drive.start]), laps=2)
        assert alone.sector_times == drive.sector_times


def test_a_lap_that_ends_at_a_wall_does_not_count_but_one_before_it_does():
    world, step = make_world("oval"), 0
    (crash,) = rollout_laps(world, world.simulator(world.track), lambda seen: 0 * left(seen))
    assert (crash.sector_times, crash.lap_times, crash.lap_time) == (((),), (), None)
    assert crash.measures()["lap_time"] is None

    def then_straight_on(seen):
        nonlocal step
        step += 1
        return rule_policy(seen) if step < 300 else 0 * left(seen)

    (second,) = rollout_laps(world, world.simulator(world.track), then_straight_on, laps=2)
    assert second.collided and len(second.lap_times) == 1 and second.lap_time is None
    assert [lap["time_s"] is None for lap in second.laps()] == [False, True]
    figures = lap_figures([crash, second])["flying"]
    assert (figures["begun"], figures["counted"], figures["mean_s"]) == (3, 1, round(second.lap_times[0], 3))


def test_a_wall_between_the_last_gate_and_the_line_spoils_the_lap():
    """The gates of a whole lap are passed by then, so that the drive itself is over."""
    world = make_world("oval")
    simulator, station = world.simulator(world.track), torch.tensor([3 * world.track.length / 8 - 1.0])
    (clean,) = rollout(world, simulator, rule_policy, station)
    step = 0

    def into_the_wall(seen):
        nonlocal step
        step += 1
        return rule_policy(seen) if step <= clean.lap_steps else left(seen)

    (driven,) = rollout(world, simulator, into_the_wall, station)
    assert (driven.lap_completed, driven.lap_steps) == (True, clean.lap_steps)
    assert clean.lap_time is not None and driven.lap_time is None


def test_a_car_that_stops_between_the_last_gate_and_the_line_does_not_come_round(pedals):
    world, policy = pedals
    simulator, station = world.simulator(world.track), torch.tensor([3 * world.track.length / 8 - 1.0])
    (clean,) = rollout(world, simulator, policy, station)
    step = 0

    def then_brake(seen):
        nonlocal step
        step += 1
        return policy(seen) if step <= clean.lap_steps - 20 else torch.tensor([[0.0, -1.0]] * len(seen))

    (driven,) = rollout(world, simulator, then_brake, station)
    assert clean.lap_time is not None and driven.lap_time is None


def test_grip_used_is_the_share_of_mu_g():
    """3 m/s^2 along and 4 across are 5 of 9.81; none is none."""
    world = make_world(vehicle=Kinematic(friction=1.0), action=ContinuousActions(("steer", "pedal")))
    state = torch.zeros(2, 9)
    state[0, 7], state[0, 8] = -3.0, 4.0
    grip = _grip(CarState.at(state), world.simulator(world.track))
    assert grip == pytest.approx({"grip_mean": 2.5 / 9.81, "grip_greatest": 5 / 9.81})


def test_a_car_whose_grip_is_not_known_tells_of_none_and_another_of_its_greatest(pedals):
    world, policy = pedals
    drives = rollout_laps(world, world.simulator(world.track), policy, starts=2)
    greatest = max(drive.grip_greatest for drive in drives)
    assert 0 < drives[0].grip_mean < drives[0].grip_greatest
    assert aggregate([drives], 1.0)["grip_greatest"] == greatest
    assert EvaluationResult(tuple(drives)).measures()["grip_greatest"] == greatest
    world = make_world("oval")
    (driven,) = rollout_laps(world, world.simulator(world.track), rule_policy)
    assert not {"grip_mean", "grip_greatest"} & (driven.measures().keys() | aggregate([[driven]], 1.0).keys())


def test_of_as_many_laps_the_faster_ones_are_better_also_where_the_car_drove_less_fast(pedals):
    world, policy = pedals
    (lap,) = rollout_laps(world, world.simulator(world.track), policy)
    slow = replace(lap, sector_times=tuple((*sectors[:2], sectors[2] + 0.01) for sectors in lap.sector_times))
    long_way_round = replace(slow, mean_speed=2 * lap.mean_speed)
    crash = replace(lap, lap_completed=False, collided=True, progress=0.9, sector_times=((1.0,),))
    assert EvaluationResult((lap,)).quality > EvaluationResult((long_way_round,)).quality
    assert EvaluationResult((slow, slow)).quality > EvaluationResult((lap, crash)).quality
    further = replace(crash, progress=0.95)
    assert EvaluationResult((slow, further)).quality > EvaluationResult((lap, crash)).quality
    measures = EvaluationResult((lap, slow, crash)).measures()
    assert measures["lap_time"] == pytest.approx(lap.lap_time + 0.005, abs=1e-3)
    assert measures["best_lap_time"] == round(lap.lap_time, 3)
    assert EvaluationResult((crash, crash)).measures()["lap_time"] is None


def test_figures_are_beside_the_limit_of_the_track(pedals):
    world, policy = pedals
    drives = rollout_laps(world, world.simulator(world.track), policy, starts=2, laps=3)
    flying = [time for drive in drives for time in drive.lap_times[1:]]
    figures = lap_figures(drives, limit=10.0)
    assert (figures["standing"]["counted"], figures["flying"]["counted"], figures["limit_s"]) == (2, 4, 10.0)
    assert figures["flying"]["mean_s"] == pytest.approx(np.mean(flying), abs=1e-3)
    assert figures["flying"]["best_s"] == round(min(flying), 3)
    assert figures["flying"]["share_of_limit"] == pytest.approx(np.mean(flying) / 10)
    assert sum(figures["flying"]["sectors_s"]) == pytest.approx(np.mean(flying), abs=2e-3)
    assert "limit_s" not in lap_figures(drives)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"ovall": 20.0}, "a limit is given for track 'ovall', which is not driven; driven: oval"),
        ({"oval": 0.0}, "the limit of track 'oval' is 0.0; it must be a positive number of seconds"),
        ({"oval": math.inf}, "it must be a positive number of seconds"),
        ({"oval": True}, "it must be a positive number of seconds"),
    ],
)
def test_a_limit_that_is_none_is_refused(limits, message):
    with pytest.raises(ConfigError, match=message):
        checked_limits(limits, [Track.load("oval")])


def test_the_speed_trace_has_a_row_for_each_moment_of_the_lap(pedals):
    world, policy = pedals
    (driven,) = rollout_laps(world, world.simulator(world.track), policy, laps=2)
    header, *rows = [
        line.split(",") for line in speed_table([TracedDrive("rule", world.track, driven)], world.vehicle).splitlines()
    ]
    assert tuple(header) == HEADER and len(rows) == driven.lap_steps + 1
    figures = np.array([row[2:] for row in rows], dtype=float)
    assert np.diff(figures[:, 1]) == pytest.approx(0.1)
    assert figures[:, 6] == pytest.approx(driven.speeds, abs=1e-4)
    assert figures[:, 3:6] == pytest.approx(driven.poses, abs=1e-4)
    ways = np.diff(figures[:, 2]) % world.track.length  # a lap along the centreline, over the start line once
    assert ways.sum() == pytest.approx(world.track.length, abs=ways.max())
    assert ways.max() < 2 * figures[:, 6].max() * 0.1


def test_a_speed_trace_that_is_read_again_has_the_lap_time_that_was_measured(pedals, tmp_path):
    world, policy = pedals
    for laps in (1, 2):
        (driven,) = rollout_laps(world, world.simulator(world.track), policy, laps=laps)
        path = tmp_path / f"{laps}.csv"
        path.write_text(speed_table([TracedDrive("rule", world.track, driven)], world.vehicle))
        (lap,) = read_laps([path], world.track)
        assert lap.lap_time == pytest.approx(sum(driven.sector_times[-1]), abs=0.01)
        assert lap.is_standing == (laps == 1)


def test_the_trace_of_a_car_of_one_speed_has_that():
    world = make_world("oval")
    (driven,) = rollout_laps(world, world.simulator(world.track), rule_policy)
    row = speed_table([TracedDrive("rule", world.track, driven)], world.vehicle).splitlines()[1]
    assert row == "rule,oval,0.0,0.0,0.0,20.0,0.0,0.0,10.0"
