"""Trials of a network on several circuits, and figures of many drives."""

from dataclasses import replace

import pytest

from carrl.evaluation.rollout import drive, rule_policy
from carrl.evaluation.tally import tally
from carrl.evaluation.trial import Trial
from tests.worlds import make_world


@pytest.fixture(scope="module")
def lap():
    """A complete lap of the oval by the rule."""
    world = make_world("oval")
    (found,) = drive(world, world.simulator(world.track), rule_policy)
    return found


@pytest.fixture(scope="module")
def crash(lap):
    """A drive that ended at a wall after half as many steps."""
    return replace(lap, lap_completed=False, collided=True, progress=0.5, lap_steps=lap.lap_steps // 2)


def test_a_trial_on_one_track_has_its_drives_own_measures(lap):
    assert Trial((lap,)).measures() == lap.measures()
    assert Trial((lap,)).lap_completed


def test_a_lap_counts_when_every_circuit_was_lapped(lap, crash):
    trial = Trial((lap, crash, lap))
    assert not trial.lap_completed
    measures = trial.measures()
    assert (measures["circuits"], measures["laps_completed"]) == (3, 2)
    assert (measures["lap_completed"], measures["collided"]) == (False, True)
    assert measures["progress"] == pytest.approx(2.5 / 3)
    assert trial.shown == 1


def test_more_laps_are_better_than_more_progress(lap, crash):
    hopeless = replace(crash, progress=0.0)
    one_lap, none = Trial((lap, hopeless)), Trial((replace(crash, progress=0.9),) * 2)
    assert one_lap.quality > none.quality
    assert Trial((lap, crash)).quality > one_lap.quality
    assert Trial((lap,)).quality > Trial((replace(lap, lap_reward=lap.lap_reward - 20),)).quality


def test_figures_of_drives_are_counts_rates_and_means(lap, crash):
    figures = tally([[lap, crash]], step_length=1.0)
    km = (lap.lap_steps + crash.lap_steps) / 1000
    assert (figures["starts"], figures["laps_completed"], figures["collisions"]) == (2, 1, 1)
    assert figures["collisions_per_km"] == pytest.approx(1 / km)
    assert figures["progress"] == 0.75
    low, high = figures["intervals"]["progress"]
    assert (low + high) / 2 == pytest.approx(0.75)
    # Two values that are 0.5 apart: the variance is 0.125, Student's quantile 12.706.
    assert high - low == pytest.approx(2 * 12.7062 * (0.125 / 2) ** 0.5, rel=1e-4)


def test_the_interval_of_several_runs_is_that_of_their_means(lap, crash):
    figures = tally([[lap, crash], [lap, crash]], step_length=1.0)
    assert figures["intervals"]["progress"] == (0.75, 0.75)
    assert figures["starts"] == 4
