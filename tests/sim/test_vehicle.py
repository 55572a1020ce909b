"""The car's motion, against numbers worked by hand."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carrl.errors import ConfigError
from carrl.sim.vehicle import Bicycle, Vehicle, VehicleModel
from tests.sim.steering import ACTIONS, FORWARD, LEFT, RIGHT, steer


def drive(vehicle: VehicleModel, pose: tuple[float, float, float], *actions: int) -> list[float]:
    state = torch.tensor([pose], dtype=torch.float64)
    for action in actions:
        state = vehicle.step(state, steer(torch.tensor([action])))
    return state[0].tolist()


def test_forward_moves_one_step_length_along_the_heading():
    vehicle = Vehicle(speed=20.0, time_step=0.25)
    assert vehicle.step_length == 5.0
    assert drive(vehicle, (1.0, 2.0, math.atan2(4, 3)), FORWARD) == pytest.approx([4, 6, math.atan2(4, 3)])


def test_left_turns_counter_clockwise_before_it_moves():
    vehicle = Vehicle(speed=10.0, time_step=0.1, turn_radius=6 / math.pi)  # 1 m and 30 degrees a step
    assert vehicle.yaw_per_step == pytest.approx(math.radians(30))
    assert drive(vehicle, (0.0, 0.0, 0.0), LEFT) == pytest.approx([math.sqrt(3) / 2, 0.5, math.pi / 6])


def test_right_is_the_mirror_image_of_left():
    vehicle = Vehicle(turn_radius=6 / math.pi)
    assert drive(vehicle, (0.0, 0.0, 0.0), RIGHT) == pytest.approx([math.sqrt(3) / 2, -0.5, -math.pi / 6])


def test_left_then_right_restores_the_heading_but_not_the_line():
    vehicle = Vehicle(turn_radius=6 / math.pi)
    x, y, heading = drive(vehicle, (0.0, 0.0, 0.0), LEFT, RIGHT)
    assert [x, y, heading] == pytest.approx([1 + math.sqrt(3) / 2, 0.5, 0.0])


def test_the_default_car_yaws_eight_degrees_a_step():
    assert math.degrees(Vehicle().yaw_per_step) == pytest.approx(8, abs=0.05)


@pytest.mark.parametrize("action", [LEFT, RIGHT])
def test_the_polygon_of_the_turning_circle_closes_after_a_full_turn(action: int):
    sides = 45
    vehicle = Vehicle(speed=10.0, time_step=0.1, turn_radius=sides / (2 * math.pi))
    assert drive(vehicle, (3.0, -2.0, 1.0), *[action] * sides) == pytest.approx([3.0, -2.0, 1.0], abs=1e-9)
    half_way = drive(vehicle, (3.0, -2.0, 1.0), *[action] * (sides // 2))
    diameter = 1 / math.sin(math.pi / sides)  # of the regular polygon with sides of 1 m
    assert math.dist(half_way[:2], (3.0, -2.0)) == pytest.approx(diameter, rel=1e-3)


def test_the_heading_wraps_to_the_other_side_at_half_a_turn():
    vehicle = Vehicle(turn_radius=6 / math.pi)
    almost = math.radians(170)
    assert drive(vehicle, (0.0, 0.0, almost), LEFT)[2] == pytest.approx(math.radians(-160))
    assert drive(vehicle, (0.0, 0.0, -almost), RIGHT)[2] == pytest.approx(math.radians(160))


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.floats(-1e3, 1e3, width=32), st.floats(0.1, 1e4), st.sampled_from(ACTIONS))
def test_the_heading_stays_within_half_a_turn_of_zero_and_points_along_the_way(heading, speed, action):
    vehicle = Vehicle(speed=speed)
    pose = vehicle.step(torch.tensor([[0.0, 0.0, heading]]), steer(torch.tensor([action])))
    x, y, after = pose[0].tolist()
    assert pose.dtype == torch.float32
    assert abs(after) <= torch.tensor(math.pi).item()
    assert [x, y] == pytest.approx(
        [vehicle.step_length * math.cos(after), vehicle.step_length * math.sin(after)],
        abs=2e-6 * (abs(heading) + vehicle.yaw_per_step + 5) * vehicle.step_length,
    )


def test_cars_side_by_side_each_follow_their_own_action():
    pose = torch.tensor([[0.0, 0.0, 0.0]] * 3)
    together = Vehicle().step(pose, steer(torch.tensor([0, 1, 2])))
    alone = torch.cat([Vehicle().step(pose[:1], steer(torch.tensor([action]))) for action in range(3)])
    assert torch.equal(together, alone)
    assert together[:, 1].sign().tolist() == [0, 1, -1]


def test_moving_leaves_the_given_pose_as_it_was():
    pose = torch.tensor([[1.0, 2.0, 3.0]])
    Vehicle().step(pose, steer(torch.tensor([1])))
    assert pose.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize("parameter", ["speed", "time_step", "turn_radius", "body_radius"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "fast", None])
def test_a_parameter_that_is_no_positive_number_is_refused_by_name_and_value(parameter: str, value: object):
    with pytest.raises(ConfigError, match=rf"^vehicle\.{parameter} is {value}; it must be a positive number$"):
        Vehicle(**{parameter: value})


# The bicycle


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("speed", "steering_angle"), [(10.0, 8.0), (3.0, 30.0), (40.0, 60.0)])
def test_a_turning_bicycle_drives_the_circle_of_its_closed_form(speed: float, steering_angle: float, side: int):
    """Every pose lies on the circle about the point that both wheels' axes meet in."""
    car = Bicycle(speed=speed, wheelbase=2.0, steering_angle=steering_angle)
    rear_to_centre = car.wheelbase / math.tan(math.radians(steering_angle))
    heading = 0.4
    # The centre lies beside the rear axle, half a wheelbase behind the car's middle.
    x = -1.0 * math.cos(heading) - side * rear_to_centre * math.sin(heading)
    y = -1.0 * math.sin(heading) + side * rear_to_centre * math.cos(heading)
    radius = math.hypot(rear_to_centre, 1.0)
    assert car.turn_radius == pytest.approx(radius)
    action = LEFT if side > 0 else RIGHT
    for steps in range(60):
        at_x, at_y, after = drive(car, (0.0, 0.0, heading), *[action] * steps)
        angle = side * steps * car.step_length / radius
        begin = math.atan2(-y, -x)
        expected = [x + radius * math.cos(begin + angle), y + radius * math.sin(begin + angle)]
        assert [at_x, at_y] == pytest.approx(expected, abs=1e-9)
        assert math.cos(after - heading - angle) == pytest.approx(1.0)


def test_a_bicycle_that_does_not_steer_drives_straight_on():
    assert drive(Bicycle(speed=20.0), (1.0, 2.0, math.atan2(3, 4)), FORWARD) == pytest.approx(
        [2.6, 3.2, math.atan2(3, 4)]
    )


def test_a_bicycle_moves_alike_in_short_and_in_long_steps():
    coarse = drive(Bicycle(time_step=0.4), (0.0, 0.0, 0.0), LEFT)
    assert drive(Bicycle(time_step=0.1), (0.0, 0.0, 0.0), *[LEFT] * 4) == pytest.approx(coarse)


@pytest.mark.parametrize("parameter", ["speed", "time_step", "wheelbase", "steering_angle", "body_radius"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, "fast"])
def test_a_bicycle_that_cannot_be_built_is_refused(parameter: str, value: object):
    with pytest.raises(ConfigError, match=rf"^vehicle\.{parameter} is {value}; it must be a positive number$"):
        Bicycle(**{parameter: value})


def test_a_wheel_turned_by_more_than_a_right_angle_is_refused():
    with pytest.raises(ConfigError, match=r"vehicle\.steering_angle is 90; it must be less than 90 degrees"):
        Bicycle(steering_angle=90)
