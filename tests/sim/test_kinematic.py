"""The kinematic bicycle with a speed of its own, against numbers worked by hand."""

import math

import pytest
import torch

from carrl.errors import ConfigError
from carrl.sim.driven import MOTION
from carrl.sim.kinematic import Kinematic
from tests.sim.cars import at, by_kernel, drive, random_controls, random_starts


def test_full_braking_takes_the_square_of_the_speed_by_twice_the_braking():
    car = Kinematic(max_braking=8.0)
    stopped = drive(car, at(car, speed=20.0), 0.0, -1.0, steps=25)
    assert stopped["x"] == pytest.approx(20.0**2 / (2 * 8.0))
    assert (stopped["speed"], stopped["y"]) == (0, 0)
    assert drive(car, at(car, speed=20.0), 0.0, -1.0, steps=60)["x"] == pytest.approx(25.0)


def test_half_the_pedal_drives_half_as_hard_up_to_full_speed():
    car = Kinematic(max_acceleration=4.0, max_speed=5.0)
    second = drive(car, at(car), 0.0, 0.5, steps=10)
    assert second["speed"] == pytest.approx(2.0) and second["x"] == pytest.approx(1.0)
    assert second["acceleration"] == pytest.approx(2.0)
    assert drive(car, at(car), 0.0, 0.5, steps=40)["speed"] == 5.0


def test_two_pedals_are_released_at_minus_one_and_add_up():
    car = Kinematic(pedals="two", max_acceleration=4.0, max_braking=8.0)
    assert car.control_names == ("steer", "throttle", "brake")
    assert drive(car, at(car, speed=10.0), 0.0, -1.0, -1.0)["acceleration"] == 0
    assert drive(car, at(car, speed=10.0), 0.0, 1.0, -1.0)["acceleration"] == pytest.approx(4.0)
    assert drive(car, at(car, speed=10.0), 0.0, 0.0, 0.0)["acceleration"] == pytest.approx(0.5 * 4 - 0.5 * 8)


@pytest.mark.parametrize("side", [1, -1])
def test_a_slow_turn_is_the_circle_about_the_point_that_both_wheels_axes_meet_in(side: int):
    """10 m behind and 24 m beside that point is the centre of gravity: it drives a circle of 26 m."""
    steering, wheelbase = math.atan(15 / 24), 15.0
    car = Kinematic(wheelbase=wheelbase, rear_axle=10.0, max_steering=steering, friction=10.0)
    assert car.turn_radius == pytest.approx(26.0)
    rate = 5.0 / 26.0
    state = at(car, speed=5.0, steering=side * steering)
    steps = 20
    after = drive(car, state, side, 0.0, steps=steps)
    # From the centre of the circle the car starts at (10, -24 side), as seen with its heading along x.
    angle = side * steps * 0.1 * rate
    x = 10 * math.cos(angle) + 24 * side * math.sin(angle)
    y = 10 * math.sin(angle) - 24 * side * math.cos(angle)
    assert (after["x"], after["y"]) == pytest.approx((x - 10, y + 24 * side))
    assert after["heading"] == pytest.approx(angle)
    assert after["yaw_rate"] == pytest.approx(side * rate)
    assert after["slip"] == pytest.approx(side * math.atan(10 / 24))
    assert after["lateral_acceleration"] == pytest.approx(side * 25 / 26)


def test_beyond_the_limit_of_grip_the_car_runs_wide():
    car = Kinematic(friction=10.0 / 9.81)
    after = drive(car, at(car, speed=20.0, steering=0.5), 1.0, 0.0)
    assert after["lateral_acceleration"] == pytest.approx(10.0)
    assert after["yaw_rate"] == pytest.approx(10.0 / 20.0)
    assert after["slip"] == pytest.approx(math.asin(car.rear_axle * 10.0 / 20.0**2))


def test_the_wheels_turn_no_faster_than_their_rate_and_stop_where_they_are_wanted():
    car = Kinematic(steering_rate=0.5, max_steering=0.3)
    assert drive(car, at(car), 1.0, 0.0)["steering"] == pytest.approx(0.05)
    assert drive(car, at(car), 1.0, 0.0, steps=10)["steering"] == pytest.approx(0.3)
    assert drive(car, at(car), -0.1, 0.0)["steering"] == pytest.approx(-0.03)
    by_rate = Kinematic(steering="rate", steering_rate=0.5, max_steering=0.3)
    assert drive(by_rate, at(car), 0.4, 0.0)["steering"] == pytest.approx(0.02)
    assert drive(by_rate, at(car), -1.0, 0.0, steps=10)["steering"] == pytest.approx(-0.3)


@pytest.mark.parametrize(("speed", "expected"), [(0.0, 1.0), (10.0, 0.57), (50.0, 0.2)])
def test_the_steering_range_narrows_with_the_speed_to_a_fifth_of_the_lock(speed: float, expected: float):
    """At 10 m/s: 2 m * 25 m/s^2 / 100 m^2/s^2 + 0.07 rad."""
    car = Kinematic(wheelbase=2.0, max_steering=1.0, steering_rate=100.0)
    assert drive(car, at(car, speed=speed), 1.0, 0.0)["steering"] == pytest.approx(expected)


@pytest.mark.parametrize("options", [{}, {"steering": "rate", "pedals": "two"}])
def test_the_machine_code_computes_what_torch_does(options: dict[str, str]):
    car = Kinematic(**options)
    generator = torch.Generator().manual_seed(0)
    state = random_starts(car, 500, generator)
    for _ in range(60):
        control = random_controls(car, 500, generator)
        after, compiled = car.step(state, control), by_kernel(car, state, control)
        torch.testing.assert_close(compiled, after, atol=1e-6, rtol=2**-23)
        assert after.dtype == torch.float32
        state = compiled
    assert (state[:, MOTION.index("lateral_acceleration")].abs() <= 1.0489 * 9.81 * (1 + 1e-6)).all()
    assert (state[:, MOTION.index("speed")] == 0).any()


def test_a_start_has_the_speed_that_the_car_can_drive_or_none():
    car, pose = Kinematic(max_speed=30.0), torch.tensor([[1.0, 2.0, 3.0]])
    assert car.initial_state(pose).tolist() == [[1, 2, 3, 0, 0, 0, 0, 0, 0]]
    assert car.initial_state(pose, torch.tensor([30.0])).tolist() == [[1, 2, 3, 30, 0, 0, 0, 0, 0]]
    for wrong in (-1.0, 31.0, math.nan):
        with pytest.raises(ConfigError, match=r"^start\.speed is .* m/s; it must lie between 0 and the car's 30$"):
            car.initial_state(pose, torch.tensor([wrong]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steering": "wheel"}, r"^vehicle\.steering is 'wheel'; it must be angle or rate$"),
        ({"pedals": "three"}, r"^vehicle\.pedals is 'three'; it must be one or two$"),
        ({"max_speed": 0}, r"^vehicle\.max_speed is 0; it must be a positive number$"),
        ({"max_steering": 1.6}, r"^vehicle\.max_steering is 1\.6; it must be less than 1\.57 rad$"),
        ({"rear_axle": 3.0}, r"^vehicle\.rear_axle is 3\.0; it must be less than the wheelbase$"),
    ],
)
def test_a_car_that_cannot_be_built_is_refused(options: dict[str, object], message: str):
    with pytest.raises(ConfigError, match=message):
        Kinematic(**options)
