"""The single-track car: its motion against numbers worked by hand, and against what others compute."""

import math
import random

import pytest
import torch

from carrl.errors import ConfigError
from carrl.sim.driven import GRAVITY, MOTION
from carrl.sim.presets import PRESETS
from carrl.sim.single_track import SingleTrack
from tests.reference import brush_car
from tests.sim.cars import at, by_kernel, drive, random_controls, random_starts

GRIP = 1.0489 * GRAVITY
CARS = [
    {},
    {"pedals": "two", "steering": "rate"},
    {"pedals": "power"},
    {"preset": "commonroad_2", "pedals": "power"},
    {"time_step": 0.04, "pedals": "speed", "min_speed": -8.0},
    {"preset": "commonroad_2"},
    {"preset": "commonroad_2", "tyre": "brush"},
    {"preset": "f1tenth"},
    {"preset": "f1tenth", "tyre": "brush"},
]
SPEED, YAW_RATE, SLIP, STEERING, ACCELERATION, LATERAL = range(3, 9)


def name(options: dict[str, object]) -> str:
    return "-".join(map(str, options.values())) or "race"


# Speed and braking


def test_braking_takes_the_square_of_the_speed_by_twice_the_braking_and_a_little_to_come_to_rest():
    """8 m/s^2 from 20 m/s take 25 m; below 0.4 m/s the brakes ease off, which adds 0.4 / 20 - 0.4^2 / 16 m."""
    car = SingleTrack()
    stopped = drive(car, at(car, speed=20.0), 0.0, -8.0 / 11.5, steps=40)
    assert stopped["x"] == pytest.approx(20.0**2 / 16 + 0.4 / 20 - 0.4**2 / 16, abs=1e-4)
    assert (stopped["speed"], stopped["slip"], stopped["y"], stopped["heading"]) == (0, 0, 0, 0)


def test_full_braking_leaves_a_fifth_of_the_grip_to_steer_with():
    car = SingleTrack()
    braking = drive(car, at(car, speed=40.0), 0.0, -1.0)
    assert braking["acceleration"] == pytest.approx(-math.sqrt(1 - 0.2**2) * 1.0489 * 9.81)
    assert braking["speed"] == pytest.approx(40.0 - 0.1 * math.sqrt(0.96) * 1.0489 * 9.81)


def test_beyond_the_power_speed_the_engine_gives_its_power_and_no_more():
    """Then the square of the speed grows by twice the power by the mass, 11.5 m/s^2 * 7.319 m/s."""
    car = SingleTrack()
    after = drive(car, at(car, speed=20.0), 0.0, 1.0, steps=10)
    assert after["speed"] == pytest.approx(math.sqrt(20.0**2 + 2 * 11.5 * 7.319), rel=1e-6)
    assert drive(car, at(car, speed=5.0), 0.0, 0.5)["acceleration"] == pytest.approx(0.5 * 11.5)
    assert drive(car, at(car, speed=50.0), 0.0, 1.0, steps=600)["speed"] == pytest.approx(50.8, abs=0.1)


@pytest.mark.parametrize("time_step", [0.01, 0.04, 0.1])
@pytest.mark.parametrize("steer", [0.0, 0.3, -1.0])
def test_a_car_starts_from_rest_and_stops_without_a_jump(time_step: float, steer: float):
    car = SingleTrack(time_step=time_step)
    state, rows = at(car), []
    for step in range(round(4 / time_step)):
        state = car.step(state, torch.tensor([[steer, 0.4 if step * time_step < 1.5 else -0.8]], dtype=torch.float64))
        rows.append(state[0])
    driven = torch.stack(rows)
    speed, change = driven[:, SPEED], driven[:, SPEED].diff()
    began = round(1.5 / time_step) - 1
    assert speed[began] > 4.5
    assert (speed >= 0).all() and (change[:began] > 0).all() and (change[began:] <= 0).all()
    assert change.abs().max() < 0.9 * 11.5 * time_step
    moves = speed > 0.01  # The direction of what stands means nothing.
    assert driven[moves, SLIP].diff().abs().max() < 0.15 + 3 * time_step
    last = driven[-round(0.5 / time_step) :]
    assert (last[:, SPEED] == 0).all() and (last[:, SLIP] == 0).all()
    assert last[:, :3].diff(dim=0).abs().max() < 1e-6
    assert last[-1, YAW_RATE].abs() < 1e-9


def test_a_race_car_has_no_reverse_gear_and_another_preset_has():
    race, f1tenth = SingleTrack(), SingleTrack(preset="f1tenth")
    assert drive(race, at(race), 0.0, -1.0, steps=20)["x"] == 0
    assert drive(f1tenth, at(f1tenth), 0.0, -0.2, steps=50)["speed"] == pytest.approx(-1.0, abs=0.02)


# Tyres


@pytest.mark.parametrize(("bend", "share"), [(0.0, 0.0), (1.0, 19 / 27), (2.0, 26 / 27), (3.0, 1.0), (30.0, 1.0)])
def test_a_brush_bends_until_it_slides(bend: float, share: float):
    """A car of stiffness 20 that slides by bend / 20 of its speed, both axles alike."""
    car = SingleTrack(front_stiffness=20.0, rear_stiffness=20.0)
    motion = torch.tensor([[0.0, 0.0, 0.0, 20.0, bend, 0.0]], dtype=torch.float64)
    still = torch.zeros(1, dtype=torch.float64)
    _, _, _, _, _, yaw, acceleration, lateral = car.rates(motion, still, still, still)[0].tolist()
    assert lateral == pytest.approx(-share * GRIP)
    assert acceleration == 0
    assert yaw == pytest.approx(0.0, abs=1e-12)  # The loads are as the arms: they balance.


def test_braking_and_cornering_share_the_grip_and_load_moves_to_the_front():
    """0.6 of the grip to brake leaves 0.8 of it, of which the brush gives 19/27 at a slip of 0.8 stiffnesses.

    The moment is that of the load moved, mass * deceleration * height.
    """
    car = SingleTrack(front_stiffness=20.0, rear_stiffness=20.0)
    motion = torch.tensor([[0.0, 0.0, 0.0, 20.0, 0.8, 0.0]], dtype=torch.float64)
    still = torch.zeros(1, dtype=torch.float64)
    _, _, _, _, _, yaw, acceleration, lateral = car.rates(motion, still, still, still - 0.6 * GRIP)[0].tolist()
    assert acceleration == pytest.approx(-0.6 * GRIP)
    assert lateral == pytest.approx(-0.8 * 19 / 27 * GRIP)
    assert yaw == pytest.approx(-1093 * 0.6 * GRIP * 0.3 * 0.8 * 19 / 27 * 1.0489 / 1792)


def test_a_turned_front_wheel_drags():
    """Its whole lateral force, from a wheel that slides, points backward by the sine of its angle."""
    car = SingleTrack()
    motion = torch.tensor([[0.0, 0.0, 0.0, 20.0, 0.0, 0.0]], dtype=torch.float64)
    still = torch.zeros(1, dtype=torch.float64)
    changes = car.rates(motion, still + 0.5, still, still)[0].tolist()
    front = 1.423 / (1.156 + 1.423) * GRIP
    assert changes[6:] == pytest.approx([-front * math.sin(0.5), front * math.cos(0.5)])
    assert changes[5] == pytest.approx(1.156 * front * math.cos(0.5) * 1093 / 1792)


@pytest.mark.parametrize("options", [each for each in CARS if each.get("tyre") or not each.get("preset")], ids=name)
def test_no_car_on_brush_tyres_ever_has_more_grip_than_there_is(options: dict[str, object]):
    car, generator = SingleTrack(**options), torch.Generator().manual_seed(1)
    state, most = random_starts(car, 400, generator), 0.0
    for step in range(200):
        if step % 7 == 0:
            control = random_controls(car, 400, generator).sign()
        after = by_kernel(car, state, control)
        most = max(most, torch.hypot(after[:, ACCELERATION], after[:, LATERAL]).max().item() / GRIP)
        way = (after[:, :2].double() - state[:, :2].double()).norm(dim=1)
        assert (way <= car.step_length + 1e-4).all()
        assert (after[:, SPEED] <= car.max_speed * (1 + 1e-6)).all()
        state = after
    assert 0.99 < most <= 1.000001


@pytest.mark.parametrize(("speed", "steering"), [(1.0, 0.5), (3.0, 0.2), (5.0, -0.1)])
def test_a_slow_car_follows_its_wheels(speed: float, steering: float):
    """It drives the kinematic circle, and slides as much as the centripetal force asks for."""
    car = SingleTrack(steering="rate")
    after = drive(car, at(car, speed=speed, steering=steering), 0.0, 0.0, steps=10)
    radius = math.hypot(car.wheelbase / math.tan(steering), car.rear_axle)
    assert abs(after["yaw_rate"]) == pytest.approx(after["speed"] / radius, rel=0.02)
    aside = after["speed"] ** 2 / radius
    slide = math.copysign(aside / (GRIP * car.rear_stiffness) * car.slip_speed / after["speed"], steering)
    assert after["slip"] == pytest.approx(math.copysign(math.asin(car.rear_axle / radius), steering) - slide, abs=0.02)


@pytest.mark.parametrize("side", [1, -1])
def test_a_car_of_equal_linear_tyres_steers_neutrally_round_a_closed_circle(side: int):
    """The yaw rate is speed * steering / wheelbase at every speed, and after a full turn the car is where it was."""
    wheelbase, steering, speed = 2.0, 0.02, 20.0
    car = SingleTrack(
        preset="commonroad_2", front_axle=0.9, rear_axle=1.1, rear_stiffness=20.0, front_stiffness=20.0, height=1e-6
    )
    yaw_rate = speed * steering / wheelbase  # 0.2 rad/s, on a circle of 100 m
    rear_slip = speed * yaw_rate / (GRIP * 20.0)
    state = at(
        car,
        speed=speed,
        steering=side * steering,
        yaw_rate=side * yaw_rate,
        slip=side * (1.1 * yaw_rate / speed - rear_slip),
    )
    car = SingleTrack(**{**vars(car), "time_step": 2 * math.pi / yaw_rate / 300})
    half = drive(car, state, 0.0, 0.0, steps=150)
    assert math.hypot(half["x"], half["y"]) == pytest.approx(200.0, abs=1e-3)
    assert half["lateral_acceleration"] == pytest.approx(side * speed * yaw_rate)
    full = drive(car, state, 0.0, 0.0, steps=300)
    assert [full["x"], full["y"], full["heading"]] == pytest.approx([0, 0, 0], abs=1e-3)


@pytest.mark.parametrize(
    ("preset", "speed", "eigenvalue"), [("race", 40.0, -4.3), ("commonroad_2", 40.0, 1.97), ("f1tenth", 10.0, 4.2)]
)
def test_the_race_car_stays_stable_while_it_brakes_and_the_others_do_not(preset: str, speed: float, eigenvalue: float):
    """Of slip and yaw rate, braking with 6 m/s^2, on linear tyres; found by another program."""
    car = SingleTrack(preset=preset, tyre="linear", integrator="rk4")
    still = torch.zeros(1, dtype=torch.float64)
    motion = torch.tensor([[0.0, 0.0, 0.0, speed, 0.0, 0.0]], dtype=torch.float64)
    jacobian = torch.autograd.functional.jacobian(lambda now: car.rates(now, still, still, still - 6.0)[0], motion)
    largest = torch.linalg.eigvals(jacobian[4:6, 0, 4:6]).real.max().item()
    assert largest == pytest.approx(eigenvalue, abs=0.06)


# By other programs, other ways, other places


@pytest.mark.parametrize("speed", [4.0, 10.0, 20.0, 40.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_second_at_the_limit_of_grip_is_within_a_millimetre_of_scipys_integrator(speed: float, seed: int):
    car, draw = SingleTrack(steering="rate"), random.Random(seed)
    state, side = at(car, speed=speed), draw.choice([1.0, -1.0])
    for _ in range(9 if speed > 15 else 3):  # Fast cars are at the limit then, and turn in no more.
        steer = side if abs(state[0, LATERAL]) < 0.9 * GRIP else 0.0
        state = car.step(state, torch.tensor([[steer, 0.2]], dtype=torch.float64))
    assert speed < 15 or abs(state[0, LATERAL]) > 0.9 * GRIP
    x, y, heading, now, yaw_rate, slip, steering = state[0, :7].tolist()
    start = [x, y, heading, now * math.cos(heading + slip), now * math.sin(heading + slip), yaw_rate, steering]
    controls = [(draw.uniform(-0.6, 0.6), draw.uniform(-1, 1)) for _ in range(10)]
    for control in controls:
        state = car.step(state, torch.tensor([control], dtype=torch.float64))
    rates = [(car.steering_rate * steer, car.max_acceleration * pedal) for steer, pedal in controls]
    motion, steering = brush_car.drive(car, start, rates, car.time_step)
    assert steering == pytest.approx(state[0, STEERING].item())
    assert math.dist(motion[:2], state[0, :2].tolist()) < 1e-3
    assert math.hypot(motion[3], motion[4]) == pytest.approx(state[0, SPEED].item(), abs=0.02)


@pytest.mark.parametrize("options", CARS, ids=name)
def test_the_machine_code_computes_what_torch_does(options: dict[str, object]):
    car, generator = SingleTrack(**options), torch.Generator().manual_seed(2)
    state = random_starts(car, 300, generator)
    for step in range(40):
        if step % 4 == 0:
            control = random_controls(car, 300, generator)
        after, compiled = car.step(state, control), by_kernel(car, state, control)
        assert after.dtype == torch.float32
        tame = compiled[:, YAW_RATE].abs() < 20  # Linear tyres spin without limit.
        torch.testing.assert_close(compiled[tame], after[tame], atol=1e-6, rtol=1e-6)
        state = torch.where(tame[:, None], compiled, state)


@pytest.mark.parametrize("options", CARS, ids=name)
def test_a_mirrored_car_drives_the_mirror_image(options: dict[str, object]):
    car, generator = SingleTrack(**options), torch.Generator().manual_seed(3)
    flipped = ("y", "heading", "yaw_rate", "slip", "steering", "lateral_acceleration", "steer_command")
    flip = torch.tensor([-1.0 if each.removeprefix("earlier_") in flipped else 1.0 for each in car.state_names])
    turn = torch.tensor([-1.0 if each == "steer" else 1.0 for each in car.control_names])
    state = random_starts(car, 50, generator).double()
    mirrored = state * flip
    for _ in range(20):
        control = random_controls(car, 50, generator).double()
        state, mirrored = car.step(state, control), car.step(mirrored, control * turn)
    tame = state[:, YAW_RATE].abs() < 20
    torch.testing.assert_close((mirrored * flip)[tame], state[tame])


@pytest.mark.parametrize("options", CARS[:1] + CARS[3:], ids=name)
def test_a_million_random_steps_stay_finite(options: dict[str, object]):
    car, generator = SingleTrack(**options), torch.Generator().manual_seed(4)
    state = random_starts(car, 10_000, generator)
    for step in range(100):
        if step % 5 == 0:
            control = random_controls(car, 10_000, generator)
        state = by_kernel(car, state, control)
        assert state.isfinite().all()
    assert (state[:, SPEED] >= (car.min_speed if car.tyre == "linear" else 0)).all()
    assert (state[:, SPEED] <= car.max_speed * (1 + 1e-6)).all()


# Steering and pedals


def test_the_wheels_turn_at_their_rate_to_where_they_are_wanted():
    car = SingleTrack()
    assert drive(car, at(car), 1.0, 0.0)["steering"] == pytest.approx(0.08)
    assert drive(car, at(car), 0.05, 0.0)["steering"] == pytest.approx(0.05 * 1.07)
    assert drive(car, at(car), -1.0, 0.0, steps=20)["steering"] == pytest.approx(-1.07)
    # At 15 m/s the range is 2.579 m * 25 m/s^2 / 225 m^2/s^2 + 0.07 rad.
    assert drive(car, at(car, speed=15.0, steering=0.3), 1.0, 0.0)["steering"] == pytest.approx(0.07 + 2.579 / 9)
    by_rate = SingleTrack(steering="rate")
    assert drive(by_rate, at(by_rate, steering=1.0), 0.5, 0.0)["steering"] == pytest.approx(1.04)
    assert drive(by_rate, at(by_rate, steering=1.0), 0.5, 0.0, steps=5)["steering"] == pytest.approx(1.07)


def test_a_servo_turns_two_substeps_late():
    car = SingleTrack(preset="f1tenth", time_step=0.01)
    state, angles = at(car), []
    for _ in range(4):
        state = car.step(state, torch.tensor([[1.0, 0.0]], dtype=torch.float64))
        angles.append(state[0, STEERING].item())
    assert angles == pytest.approx([0, 0, 0.032, 0.064])
    assert car.state_names == (*MOTION, "steer_command", "earlier_steer_command")


def test_two_pedals_act_together():
    car = SingleTrack(pedals="two")
    assert car.control_names == ("steer", "throttle", "brake")
    assert drive(car, at(car, speed=5.0), 0.0, -1.0, -1.0)["acceleration"] == 0
    assert drive(car, at(car, speed=5.0), 0.0, 0.0, -1.0)["acceleration"] == pytest.approx(5.75)
    assert drive(car, at(car, speed=5.0), 0.0, -1.0, 0.0)["acceleration"] == pytest.approx(-5.75)
    assert drive(car, at(car, speed=5.0), 0.0, 0.5, 0.0)["acceleration"] == pytest.approx(0.25 * 11.5)


def test_half_a_pedal_is_half_the_power_at_any_speed_and_half_the_brakes():
    car = SingleTrack(pedals="power", substep=0.1, integrator="rk4")
    assert car.control_names == ("steer", "pedal")
    half = 11.5 / 2
    assert drive(car, at(car, speed=5.0), 0.0, 0.5)["acceleration"] == pytest.approx(half)
    assert drive(car, at(car, speed=29.276), 0.0, 0.5)["acceleration"] == pytest.approx(half / 4, rel=0.01)
    assert drive(SingleTrack(), at(car, speed=29.276), 0.0, 0.5)["acceleration"] == pytest.approx(11.5 / 4, rel=0.02)
    assert drive(car, at(car, speed=29.276), 0.0, -0.5)["acceleration"] == pytest.approx(-half)


# Parameters


def test_what_is_not_given_is_the_presets():
    assert {**PRESETS["f1tenth"], "preset": "f1tenth", "time_step": 0.1} == vars(SingleTrack(preset="f1tenth"))
    car = SingleTrack(friction=0.5)
    assert (car.friction, car.mass, car.wheelbase) == (0.5, 1093.0, pytest.approx(2.579))
    assert drive(car, at(car, speed=40.0), 0.0, -1.0)["acceleration"] == pytest.approx(-math.sqrt(0.96) * 0.5 * 9.81)
    assert (car.body.length, car.body.width) == (4.508, 1.61)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preset": "lorry"}, r"^vehicle\.preset is 'lorry'; it must be race or commonroad_2 or f1tenth$"),
        ({"tyre": "soft"}, r"^vehicle\.tyre is 'soft'; it must be brush or linear$"),
        ({"steering": "left"}, r"^vehicle\.steering is 'left'; it must be angle or rate or servo$"),
        ({"mass": -1.0}, r"^vehicle\.mass is -1\.0; it must be a positive number$"),
        ({"min_speed": 1.0}, r"^vehicle\.min_speed is 1\.0; it must be 0, or less for a car that reverses$"),
        ({"max_steering": 1.6}, r"^vehicle\.max_steering is 1\.6; it must be less than 1\.57 rad$"),
        ({"height": 1.2}, r"^vehicle\.height is 1\.2; at 0\.986 m the car tips over at its max_acceleration$"),
        ({"pedals": "speed"}, r"^vehicle\.pedals is 'speed'; its brakes need a vehicle\.min_speed below 0$"),
        ({"integrator": "euler"}, r"^vehicle\.integrator is 'euler', with which brush tyres are unstable; .* rk4$"),
        ({"substep": 1e-5}, r"^vehicle\.substep is 1e-05; it must be at least a thousandth of the time step$"),
    ],
)
def test_a_car_that_cannot_be_built_is_refused(options: dict[str, object], message: str):
    with pytest.raises(ConfigError, match=message):
        SingleTrack(**options)
