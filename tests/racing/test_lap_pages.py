"""Laps on roads where their times can be worked out: whatever the moments are that a car is seen at."""

import numpy as np
import pytest

from carrl.errors import TrackError
from carrl.racing.laps import Lap
from carrl.tracks.track import Track
from tests.driven_laps import moments, steady, steady_lap
from tests.racing.laps import RADIUS, ring


@pytest.fixture(scope="module")
def road():
    return ring()


@pytest.mark.parametrize("begin", [0.0, 0.7, -0.4])
def test_a_lap_at_one_speed_takes_the_length_by_the_speed_wherever_its_moments_are(road, begin):
    lap = steady_lap(road, 17.0, begin=begin)
    assert lap.lap_time == pytest.approx(road.length / 17, abs=1e-3)
    assert lap.sector_times == pytest.approx([road.length / 51] * 3, abs=1e-3)
    assert lap.time_at(np.array([100.0])) == pytest.approx([100 / 17], abs=1e-3)
    assert not lap.is_standing


def test_a_lap_from_rest_takes_what_the_acceleration_needs(road):
    times = np.arange(0, np.sqrt(2 * road.length / 5) + 0.1, 0.1)
    lap = Lap.of("rest", road, *moments(road, 2.5 * times**2, 5 * times))
    assert lap.lap_time == pytest.approx(np.sqrt(2 * road.length / 5), abs=2e-3)
    assert lap.is_standing
    assert lap.speed_at(np.array([40.0])) == pytest.approx([20.0], abs=0.05)


def test_the_gap_grows_as_a_slower_car_falls_behind(road):
    fast, slow = steady_lap(road, 20.0), steady_lap(road, 16.0)
    stations = np.array([0.0, 80.0, 160.0])
    assert slow.gap_to(fast, stations) == pytest.approx([0, 1, 2], abs=1e-3)
    assert fast.gap_to(slow, stations) == pytest.approx([0, -1, -2], abs=1e-3)
    assert fast.gap_to(fast, stations) == pytest.approx([0, 0, 0])


def test_a_lap_that_ends_early_has_no_time_and_no_gap_from_there_on(road):
    lap, whole = steady_lap(road, 20.0, end=100.0), steady_lap(road, 16.0)
    assert lap.lap_time is None
    assert lap.sector_times == (pytest.approx(road.length / 60, abs=1e-3), None, None)
    assert lap.end == pytest.approx((100.0, 5.0), abs=0.01)
    gaps = lap.gap_to(whole, np.array([80.0, 120.0]))
    assert gaps[0] == pytest.approx(-1, abs=1e-3) and np.isnan(gaps[1])
    assert np.isnan(lap.speed_at(np.array([120.0]))[0])


def test_between_its_moments_the_car_stays_on_the_arc(road):
    lap = steady_lap(road, 20.0, step=0.4)  # moments 8 m apart, whose chords are 0.2 m within the circle
    times = np.linspace(0.5, 10, 200)
    poses, stations, speeds = lap.at(times)
    assert np.linalg.norm(poses[:, :2], axis=1) == pytest.approx(RADIUS, abs=0.01)
    assert stations == pytest.approx(20 * times, abs=0.05)
    assert speeds == pytest.approx(20)
    assert (np.diff(poses[:, 2]) > 0).all()  # the heading is counted on


def test_after_its_end_a_car_stays_there(road):
    lap = steady_lap(road, 20.0)
    (end, later), stations, _ = lap.at(np.array([lap.lap_time, 1e3]))
    assert end.tolist() == later.tolist()
    assert stations == pytest.approx(road.length, abs=0.01)


def test_a_car_that_stands_still_for_a_while_comes_to_a_place_once(road):
    stations = np.concatenate([np.arange(0, 100, 2.0), np.full(30, 98.0), np.arange(100, road.length + 2, 2.0)])
    lap = Lap.of("pause", road, *moments(road, stations, 20.0))
    assert lap.time_at(np.array([90.0, 110.0])) == pytest.approx([4.5, 8.5], abs=0.02)


def test_a_lap_of_another_road_is_refused(road):
    with pytest.raises(TrackError, match="lap 'x': it leaves the road of track 'oval'; name the track where"):
        Lap.of("x", Track.load("oval"), *steady(road, 20.0))


def test_a_lap_that_begins_elsewhere_is_refused(road):
    with pytest.raises(TrackError, match=r"begins 20\.0 m along the road of track 'ring'; it must begin at the start"):
        steady_lap(road, 10.0, begin=20.0)


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [(0, 1e12, "it takes 1,000,000,000,000 s; it may take at most 3,600 s"), (1, 1e300, "it leaves the road")],
)
def test_times_and_places_beyond_all_measure_are_refused(road, column, value, says):
    times, poses, speeds = steady(road, 20.0)
    table = np.column_stack([times, poses])
    table[-1, column] = value
    with pytest.raises(TrackError, match=says):
        Lap.of("lap", road, table[:, 0], table[:, 1:], speeds)
