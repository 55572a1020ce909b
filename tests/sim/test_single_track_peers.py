"""Linear tyres against CommonRoad's own program, and F1TENTH's car against its equations in plain numbers."""

import math
import random

import pytest
import torch
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

from carrl.sim.single_track import SingleTrack
from tests.reference import scalar_f1tenth
from tests.sim.cars import at

SECOND_CAR = parameters_vehicle2()


def ours(car: SingleTrack, state: list[float], rate: float, acceleration: float) -> list[float]:
    """The derivative of [x, y, steering angle, speed, heading, yaw rate, slip]."""
    x, y, steering, speed, heading, yaw_rate, slip = state
    motion = torch.tensor([[x, y, heading, speed, slip, yaw_rate]], dtype=torch.float64)
    given = (torch.tensor([value], dtype=torch.float64) for value in (steering, rate, acceleration))
    dx, dy, turn, dv, dslip, dyaw, _, _ = car.rates(motion, *given)[0].tolist()
    return [dx, dy, rate, dv, turn, dyaw, dslip]


def test_linear_tyres_change_the_motion_as_commonroads_do():
    """On 1,000 states faster than 1 m/s, beyond the limits of acceleration and of speed, too."""
    car, draw = SingleTrack(preset="commonroad_2", kinematic_below=1.0), random.Random(0)
    for number in range(1000):
        speed = [draw.uniform(1, 60), draw.uniform(-14.5, -1)][number % 5 == 0]
        place = draw.uniform(-100, 100), draw.uniform(-100, 100), draw.uniform(-1, 1), speed
        state = [*place, draw.uniform(-3, 3), draw.uniform(-2, 2), draw.uniform(-0.5, 0.5)]
        rate, acceleration = draw.uniform(-0.39, 0.39), draw.uniform(-15, 15)
        expected = vehicle_dynamics_st(state, [rate, acceleration], SECOND_CAR)
        assert ours(car, state, rate, acceleration) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_commonroads_slip_is_off_below_a_tenth_of_a_metre_a_second():
    """Of 3.0.2: it has tan^2(steering) * b / l where the derivative of atan(tan(steering) * b / l) has the square."""
    steering, rate = 0.8, 0.3
    *_, slip_change = vehicle_dynamics_st([0, 0, steering, 0.05, 0, 0, 0], [rate, 0.0], SECOND_CAR)
    share = 1.4227170936 / (1.4227170936 + 1.1561957064)
    right = share * rate / math.cos(steering) ** 2 / (1 + (share * math.tan(steering)) ** 2)
    theirs = share * rate / math.cos(steering) ** 2 / (1 + (share * math.tan(steering) ** 2) ** 2)
    assert slip_change == pytest.approx(theirs)
    assert abs(slip_change - right) > 0.01 * right


@pytest.mark.parametrize(
    ("parameters", "state", "given", "expected"),
    [
        (  # f1tenth_gym's own unit test
            scalar_f1tenth.COMMONROAD_1,
            [
                2.02,
                0.0042,
                0.0197545248559617,
                15.721623633429012,
                0.0025857914776859,
                0.0529001056654038,
                0.0033012170610298,
            ],
            (0.15, 0.63 * 9.81),
            [
                15.7213512030862,
                0.0925527979719,
                0.15,
                5.3536773276414,
                0.0529001056654,
                0.6435589397749,
                0.0313297971641,
            ],
        ),
        (
            scalar_f1tenth.Parameters(),
            [0, 0, 0.1, 5, 0, 0.5, 0.02],
            (0.5, 2.0),
            [4.99900003, 0.09999333, 0.5, 2, 0.5, 19.72322734, -0.22204379],
        ),
    ],
)
def test_the_plain_numbers_have_the_check_values(parameters, state, given, expected):
    assert scalar_f1tenth.derivative(parameters, state, *given) == pytest.approx(expected, rel=1e-8, abs=1e-8)
    if parameters == scalar_f1tenth.Parameters():
        assert ours(SingleTrack(preset="f1tenth"), state, *given) == pytest.approx(expected, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize(("time_step", "substeps"), [(0.01, 1), (0.1, 10)])
@pytest.mark.parametrize("seed", range(3))
def test_f1tenths_car_is_where_its_equations_put_it_after_a_thousand_steps(seed: int, time_step: float, substeps: int):
    """From rest, by wanted angles and speeds, backward and slow ones among them."""
    car, other, draw = SingleTrack(preset="f1tenth", time_step=time_step), scalar_f1tenth.Car(), random.Random(seed)
    state, slow, fast = at(car), 0, 0
    for step in range(1000 // substeps):
        if step % max(1, 30 // substeps) == 0:
            steer, speed = draw.uniform(-1, 1), draw.uniform(-0.1, 0.4)
        state = car.step(state, torch.tensor([[steer, speed]], dtype=torch.float64))
        for _ in range(substeps):
            other.step(0.4189 * steer, speed * (20 if speed > 0 else 5))
        x, y, steering, v, heading, yaw_rate, slip = other.state
        got = dict(zip(car.state_names, state[0].tolist(), strict=True))
        assert [got["x"], got["y"], got["speed"]] == pytest.approx([x, y, v], abs=1e-9)
        assert [got["yaw_rate"], got["slip"], got["steering"]] == pytest.approx([yaw_rate, slip, steering], abs=1e-9)
        assert math.remainder(got["heading"] - heading, 2 * math.pi) == pytest.approx(0, abs=1e-9)
        slow, fast = slow + (abs(v) < 0.5), fast + (abs(v) >= 0.5)
    assert fast > 3 and (slow > 3 or substeps > 1)


def test_a_light_turn_settles_where_the_equations_say():
    """At 3 m/s with 0.05 rad: 0.4222 rad/s, less than the 0.4546 of wheels that do not slip."""
    car = SingleTrack(preset="f1tenth", steering="rate", pedals="one")
    state = at(car, speed=3.0, steering=0.05)
    for _ in range(50):
        state = car.step(state, torch.zeros(1, 2, dtype=torch.float64))
    assert state[0, 4].item() == pytest.approx(0.4222, abs=1e-5)
    assert state[0, 5].item() == pytest.approx(0.001568, abs=1e-6)
