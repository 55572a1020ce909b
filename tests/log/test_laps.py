"""Lap times of a recorded episode: those that an evaluation of the same drive has."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import carrl
from carrl.cli.text.episode_text import _progress
from carrl.data.description import log_schema
from carrl.evaluation.baselines import rule_of, rule_policy
from carrl.evaluation.rollout import rollout
from carrl.log import Column, Log, read_trace
from carrl.log.laps import recorded_laps
from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.task.action import ContinuousActions
from tests.log.test_trace import drive
from tests.logs import dqn_columns
from tests.worlds import make_world

LOG_PROB = [Column("log_prob", "log_prob", "float64", (), "log probability of the action")]


@pytest.fixture(scope="module")
def two_laps(tmp_path_factory):
    """Some two and a half laps of the oval by the rule, in the paper's car."""
    env = carrl.TrackEnv("oval", seed=0, max_steps=1000, sensor=Sensor(max_range=10.0))
    path = tmp_path_factory.mktemp("laps") / "train.mcap"
    drive(
        path,
        env,
        log_schema(env.task, dqn_columns()),
        550,
        lambda _, now: now.set("action", rule_policy(now["observation"])),
    )
    with Log(path) as log:
        return read_trace(log, 0)


def with_columns(trace, **columns):
    return replace(trace, columns={**trace.columns, **columns})


def test_laps_of_an_episode_from_the_start_line_are_those_that_an_evaluation_times(two_laps):
    world = make_world("oval")
    (driven,) = rollout(world, world.simulator(world.track), rule_policy, torch.zeros(1), laps=2)
    laps = recorded_laps(two_laps)
    assert [lap.seconds for lap in laps] == pytest.approx(driven.lap_times, abs=1e-6)
    assert all(lap.counts for lap in laps)
    assert [two_laps.gates_passed[lap.row + 1] for lap in laps] == [8, 16]
    assert _progress(two_laps) == f"20 gates, 2 laps ({laps[0].seconds:.2f} s, {laps[1].seconds:.2f} s)"


def test_a_car_with_pedals_has_the_lap_time_of_an_evaluation_too(tmp_path):
    action, sensor = ContinuousActions(("steer", "pedal")), Sensor(rays=9, max_range=30.0)
    world, policy = rule_of(make_world("oval", vehicle=Kinematic(), sensor=sensor, action=action))
    (driven,) = rollout(world, world.simulator(world.track), policy, torch.zeros(1))
    env = carrl.TrackEnv(
        "oval", seed=0, vehicle=Kinematic(), sensor=sensor, action=action, observation=world.observation
    )
    path = tmp_path / "train.mcap"
    drive(
        path,
        env,
        log_schema(env.task, LOG_PROB),
        driven.lap_steps + 1,
        lambda _, now: now.set("action", policy(now["observation"])),
    )
    with Log(path) as log:
        (lap,) = recorded_laps(read_trace(log, 0))
    assert lap.seconds == pytest.approx(driven.lap_time, abs=1e-6)


def test_an_episode_that_begins_between_gates_has_its_lap_at_the_second_passing_of_the_one_before(two_laps):
    cut = replace(two_laps, columns={name: values[10:] for name, values in two_laps.columns.items()})
    cut = with_columns(cut, step=np.arange(len(cut)))
    (lap,) = recorded_laps(cut)
    assert lap.seconds == pytest.approx(recorded_laps(two_laps)[1].seconds, abs=1e-6)
    assert lap.row == recorded_laps(two_laps)[1].row - 10


def test_a_lap_in_which_the_car_touched_a_wall_does_not_count(two_laps):
    collided = np.zeros((len(two_laps), 1), dtype=bool)
    collided[recorded_laps(two_laps)[0].row + 5] = True
    touched = with_columns(two_laps, collided=collided)
    assert [lap.counts for lap in recorded_laps(touched)] == [True, False]
    assert "s with contact)" in _progress(touched)


def test_there_are_no_laps_where_the_log_lacks_steps_or_does_not_say_where_the_car_was(two_laps):
    late = with_columns(two_laps, step=two_laps.columns["step"] + 3)
    gap = with_columns(two_laps, step=np.where(np.arange(len(two_laps)) < 50, 0, 9) + two_laps.columns["step"])
    unknown = with_columns(two_laps, next_gate=np.full(len(two_laps), -1))
    nowhere = with_columns(two_laps, state=np.full_like(two_laps.columns["state"], np.nan))
    assert [recorded_laps(trace) for trace in (late, gap, unknown, nowhere)] == [[]] * 4
