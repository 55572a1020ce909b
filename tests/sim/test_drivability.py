"""Whether a road suits a car: its width, its bends, one step of turning, the zone near its walls."""

import dataclasses
import math

import numpy as np
import pytest

from carrl.sim.drivability import Car, metres, tightest_bend, unsuitable
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import Bicycle, Vehicle
from carrl.task.reward import paper_reward
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track, builtin_names
from tests.sim.shapes import rounded_road, straight_road_track

SMALL = Car(turn_radius=0.7, step_length=0.1, body_radius=0.15, near_wall=0.2)


def polygon(corners: list[tuple[float, float]], width: float) -> Track:
    points = np.array(corners, dtype=float)
    return Track.from_centreline("polygon", Centreline(points, *np.full((2, len(points)), width / 2)))


def test_the_default_car_is_that_of_the_default_configuration():
    car, default = Car.of(Vehicle(), Sensor(), paper_reward().near_wall.threshold), Car()
    assert dataclasses.astuple(car) == pytest.approx(dataclasses.astuple(default), rel=1e-2)


def test_a_car_turns_as_tightly_as_its_model_says_and_looks_as_far_sideways_as_its_rays():
    bicycle = Bicycle(wheelbase=0.33, steering_angle=20, speed=1.0)
    car = Car.of(bicycle, Sensor(rays=5, field_of_view=60, max_range=10), 0.1)
    assert car.turn_radius == pytest.approx(bicycle.turn_radius, rel=1e-6)
    assert car.near_wall == pytest.approx(0.5)  # a ray at 30 degrees reads 1 m where the wall is 0.5 m beside the car


@pytest.mark.parametrize("name", builtin_names())
def test_the_default_car_drives_the_builtin_tracks(name: str):
    assert unsuitable(Track.load(name), Car()) == []


@pytest.mark.parametrize("spacing", [0.3, 1.0])
def test_a_half_circle_is_driven_along_its_outside_at_best(spacing: float):
    """Middle 5 m, room 2 m to each side of the car's middle: 7 m, since tan(180 / 4 degrees) is 1."""
    road = rounded_road([(0, 0), (40, 0), (40, 10), (0, 10)], radius=4.99, width=5.0, point_spacing=spacing)
    radius, station = tightest_bend(road, Car(turn_radius=9.0))
    assert radius == pytest.approx(7.0, abs=0.35)
    assert min(abs(station - 28), abs(station - 75)) < 8
    assert unsuitable(road, Car(turn_radius=6.0)) == []
    (phrase,) = unsuitable(road, Car(turn_radius=9.0))
    assert phrase.endswith("and the car's is 9.0 m")


def test_a_right_angle_without_any_radius_can_be_cut():
    """Room w to each side: w / tan(22.5 degrees)^2 = 5.83 w, so 20.4 m on a road 8 m wide."""
    square = polygon([(0, 0), (90, 0), (90, 90), (0, 90)], 8.0)
    radius, _ = tightest_bend(square, Car(turn_radius=40.0))
    assert radius == pytest.approx(3.5 / math.tan(math.radians(22.5)) ** 2, rel=0.1)
    assert unsuitable(square, Car()) == []
    assert unsuitable(square, Car(turn_radius=18.0)) == []
    assert len(unsuitable(square, Car(turn_radius=30.0))) == 1


@pytest.mark.parametrize("first", [0, 1, 2, 3])
def test_a_bend_at_the_start_line_counts_like_any_other(first: int):
    corners = np.roll([(0, 0), (60, 0), (60, 6), (0, 6)], -first, axis=0)
    radius, _ = tightest_bend(polygon(corners, 3.0), Car())
    assert radius == pytest.approx(3.0 + 1.0, abs=0.4)


def test_a_road_too_narrow_for_the_car_is_told_first_and_alone():
    road = straight_road_track(width=0.6)
    assert unsuitable(road, Car()) == ["the road is 0.60 m wide and the car 1.00 m"]
    assert unsuitable(road, SMALL) == []


def test_a_step_of_turning_that_leaves_the_road_is_told():
    """1 m along a circle of 0.7 m turns by 82 degrees: 0.99 m sideways, with 0.75 m of room."""
    (phrase,) = unsuitable(straight_road_track(width=1.8), dataclasses.replace(SMALL, step_length=1.0))
    assert phrase == ("one step of turning moves the car 0.99 m sideways, and the road, 1.80 m wide, leaves it 0.75 m")


def test_a_road_all_of_which_is_near_a_wall_is_told():
    (phrase,) = unsuitable(straight_road_track(width=1.8), dataclasses.replace(SMALL, near_wall=1.0))
    assert phrase.startswith("all of the road, 1.80 m wide, is within 1.00 m of a wall")


def test_lengths_below_two_metres_have_two_digits():
    assert [metres(length) for length in (0.187, 1.999, 2.0, 1234.56)] == ["0.19 m", "2.00 m", "2.0 m", "1,234.6 m"]
