"""The checks of a minimum lap pass for one, and tell when it is none."""

import dataclasses

import pytest

from carrl.racing.checks import check_lap
from carrl.sim.single_track import SingleTrack
from carrl.tracks.track import Track
from tests.racing.laps import oval_lap


@pytest.fixture(scope="module")
def checks():
    return check_lap(Track.load("oval"), SingleTrack(), oval_lap())


def test_all_pass_for_a_minimum_lap(checks):
    names = ["two grids", "another method", "grip", "walls", "three starts", "replay"]
    assert [check.name for check in checks] == names
    assert all(check.passed for check in checks), checks


def test_a_lap_that_is_slower_than_it_must_be_fails_where_it_is_found_in_other_ways():
    lap = oval_lap()
    slow = dataclasses.replace(lap, line=dataclasses.replace(lap.line, lap_time=1.01 * lap.lap_time), at_walls=0.0)
    checks = {check.name: check for check in check_lap(Track.load("oval"), SingleTrack(), slow)}
    failed = {name for name, check in checks.items() if not check.passed}
    assert failed >= {"two grids", "three starts", "walls"}
    assert checks["two grids"].value == pytest.approx(0.01, abs=1e-3)
