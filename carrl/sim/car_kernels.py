"""The steps of cars that are steered, driven and braked as machine code for the CPU, one car at a time.

They compute what `carrl.sim.kinematic` and `carrl.sim.single_track` state in torch; tests compare the two. All is
float64 and rounded to float32 once.

Shapes: `N` cars, `S` entries of the state, `C` controls, `K` constants, in the order in which the vehicle lists them.
Lengths are in metres, angles in radians, counter-clockwise and to the left positive.
"""

import math
from typing import NamedTuple

import numpy as np

from carrl.sim.machine_code import compiled, inlined

_Motion = tuple[float, float, float, float, float, float]
_Change = tuple[float, float, float, float, float, float, float, float]


@compiled
def drive_kinematic(state: np.ndarray, control: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """The next states [N, S], float32, of states [N, S], controls [N, C], both float32, and constants [K]."""
    by_angle, time_step, wheelbase, rear_axle, lock, rate, max_speed, drive, brake, grip = constants[:10]
    moved = np.empty_like(state)
    for car in range(len(state)):
        heading, speed, steering = np.float64(state[car, 2]), np.float64(state[car, 3]), np.float64(state[car, 6])
        steer, most = np.float64(control[car, 0]), rate * time_step
        if by_angle:
            wanted = steer * _steering_range(speed, wheelbase, lock, constants[10:])
            new_steering = steering + _within(wanted - steering, most)
        else:
            new_steering = _within(steering + steer * most, lock)
        acceleration = _throttle(control[car]) * drive - _brake(control[car]) * brake
        new_speed = max(min(speed + acceleration * time_step, max_speed), 0.0)
        middle = (speed + new_speed) / 2
        curvature = _curvature((steering + new_steering) / 2, middle, wheelbase, rear_axle, grip)
        half_turn, chord = middle * time_step * curvature / 2, middle * time_step
        if half_turn != 0:
            chord *= math.sin(half_turn) / half_turn
        direction = heading + math.asin(rear_axle * curvature) + half_turn
        new_curvature = _curvature(new_steering, new_speed, wheelbase, rear_axle, grip)
        moved[car, 0] = state[car, 0] + chord * math.cos(direction)
        moved[car, 1] = state[car, 1] + chord * math.sin(direction)
        moved[car, 2] = (heading + 2 * half_turn + math.pi) % (2 * math.pi) - math.pi
        moved[car, 3], moved[car, 4] = new_speed, new_speed * new_curvature
        moved[car, 5], moved[car, 6] = math.asin(rear_axle * new_curvature), new_steering
        moved[car, 7], moved[car, 8] = (new_speed - speed) / time_step, middle * middle * curvature
    return moved


@inlined
def _within(value: float, most: float) -> float:
    return max(min(value, most), -most)


@inlined
def _throttle(control: np.ndarray) -> float:
    """How far it is down, 0 to 1: where there is one pedal, as far as that is positive."""
    if len(control) == 2:
        return max(np.float64(control[1]), 0.0)
    return (np.float64(control[1]) + 1) / 2


@inlined
def _brake(control: np.ndarray) -> float:
    """How far it is down, 0 to 1: where there is one pedal, as far as that is negative."""
    if len(control) == 2:
        return -min(np.float64(control[1]), 0.0)
    return (np.float64(control[2]) + 1) / 2


@inlined
def _steering_range(speed: float, wheelbase: float, lock: float, shape: np.ndarray) -> float:
    """As `DrivenCar.steering_range`; `shape` is its least share of the lock, lateral acceleration and slip."""
    return max(min(wheelbase * shape[1] / (speed * speed) + shape[2], lock), shape[0] * lock)


@inlined
def _curvature(steering: float, speed: float, wheelbase: float, rear_axle: float, grip: float) -> float:
    """Of the way of the centre of gravity, 1/m."""
    rear = math.tan(steering) / wheelbase
    return _within(rear / math.sqrt(1 + (rear_axle * rear) ** 2), grip / (speed * speed))


class SingleTrackConstants(NamedTuple):
    """What `carrl.sim.single_track.SingleTrack.constants` lists."""

    has_brush_tyres: float
    steering: float
    by_speed: float
    by_euler: float
    substeps: float
    substep: float
    front_axle: float
    rear_axle: float
    height: float
    gravity: float
    friction: float
    mass_by_inertia: float
    front_stiffness: float
    rear_stiffness: float
    max_steering: float
    steering_rate: float
    max_acceleration: float
    power_speed: float
    max_speed: float
    min_speed: float
    slip_speed: float
    kinematic_below: float
    steerable: float
    full_slip: float
    ease: float
    rest: float
    most_spin: float
    dead_band: float
    forward_gain: float
    backward_gain: float


@compiled
def drive_single_track(state: np.ndarray, control: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """The next states [N, S], float32, of states [N, S], controls [N, C], both float32, and constants [K]."""
    c = constants
    car = SingleTrackConstants(
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11], c[12], c[13], c[14],
        c[15], c[16], c[17], c[18], c[19], c[20], c[21], c[22], c[23], c[24], c[25], c[26], c[27], c[28], c[29],
    )  # fmt: skip
    substep, substeps, lock = car.substep, int(car.substeps), car.max_steering
    has_brush_tyres = car.has_brush_tyres > 0
    moved = np.empty_like(state)
    for number in range(len(state)):
        speed, slip = float(state[number, 3]), float(state[number, 5])
        steering, steer = np.float64(state[number, 6]), np.float64(control[number, 0])
        command, earlier_command = steer, steer
        if car.steering == 2:
            command, earlier_command = np.float64(state[number, 9]), np.float64(state[number, 10])
        wanted_angle = steer * _steering_range(speed, car.front_axle + car.rear_axle, lock, c[30:])
        motion = (
            np.float64(state[number, 0]),
            np.float64(state[number, 1]),
            np.float64(state[number, 2]),
            speed * math.cos(slip) if has_brush_tyres else speed,
            speed * math.sin(slip) if has_brush_tyres else slip,
            np.float64(state[number, 4]),
        )
        acceleration, lateral = 0.0, 0.0
        for _ in range(substeps):
            turning = _turning(car, steering, steer, wanted_angle, earlier_command)
            wanted = _wanted(car, control[number], motion[3])
            change = _mean_rates(car, has_brush_tyres, motion, steering, turning, wanted)
            motion = _after(motion, change, substep)
            if not has_brush_tyres:
                motion = _settled(car, motion)
            acceleration, lateral = acceleration + change[6] / substeps, lateral + change[7] / substeps
            steering += substep * turning
            command, earlier_command = steer, command
        speed, slip = motion[3], motion[4]
        if has_brush_tyres:
            speed, slip = math.hypot(motion[3], motion[4]), math.atan2(motion[4], motion[3])
            if speed < car.rest:
                speed, slip = 0.0, 0.0
        moved[number, 0], moved[number, 1] = motion[0], motion[1]
        moved[number, 2] = (motion[2] + math.pi) % (2 * math.pi) - math.pi
        moved[number, 3], moved[number, 4], moved[number, 5] = speed, motion[5], slip
        moved[number, 6], moved[number, 7], moved[number, 8] = steering, acceleration, lateral
        if car.steering == 2:
            moved[number, 9], moved[number, 10] = command, earlier_command
    return moved


@inlined
def _turning(
    car: SingleTrackConstants, steering: float, steer: float, wanted_angle: float, earlier_command: float
) -> float:
    """How fast the front wheels turn in a substep, rad/s."""
    lock, rate = car.max_steering, car.steering_rate
    if car.steering == 0:
        return _within((wanted_angle - steering) / car.substep, rate)
    if car.steering == 1:
        return (_within(steering + car.substep * rate * steer, lock) - steering) / car.substep
    ahead = earlier_command * lock - steering
    turning = math.copysign(rate, ahead) if abs(ahead) > car.dead_band else 0.0
    at_stop = (steering <= -lock and turning <= 0) or (steering >= lock and turning >= 0)
    return 0.0 if at_stop else turning


@inlined
def _wanted(car: SingleTrackConstants, control: np.ndarray, speed: float) -> float:
    """The acceleration that the driver asks for, m/s^2."""
    pedal = np.float64(control[1])
    if len(control) == 3:
        return (pedal - np.float64(control[2])) / 2 * car.max_acceleration
    if not car.by_speed:
        return pedal * car.max_acceleration
    missing = pedal * (car.max_speed if pedal > 0 else -car.min_speed) - speed
    gain = (car.forward_gain if speed > 0 else car.backward_gain) * car.max_acceleration
    return missing * gain / (car.max_speed if missing > 0 else -car.min_speed)


@inlined
def _after(motion: _Motion, change: _Change, time: float) -> _Motion:
    """The motion, changing so, a time later."""
    return (
        motion[0] + time * change[0],
        motion[1] + time * change[1],
        motion[2] + time * change[2],
        motion[3] + time * change[3],
        motion[4] + time * change[4],
        motion[5] + time * change[5],
    )


@inlined
def _settled(car: SingleTrackConstants, motion: _Motion) -> _Motion:
    """As `carrl.sim.tyres.Linear.settled`."""
    return (
        motion[0],
        motion[1],
        motion[2],
        max(min(motion[3], car.max_speed), car.min_speed),
        _within(motion[4], car.most_spin),
        _within(motion[5], car.most_spin),
    )


@inlined
def _mean_rates(
    car: SingleTrackConstants, brush: bool, motion: _Motion, steering: float, turning: float, wanted: float
) -> _Change:
    """What changes in a substep, a second."""
    time = car.substep
    first = _rates(car, brush, motion, steering, turning, wanted)
    if car.by_euler:
        return first
    middle = steering + time / 2 * turning
    second = _rates(car, brush, _after(motion, first, time / 2), middle, turning, wanted)
    third = _rates(car, brush, _after(motion, second, time / 2), middle, turning, wanted)
    fourth = _rates(car, brush, _after(motion, third, time), steering + time * turning, turning, wanted)
    return (
        (first[0] + 2 * second[0] + 2 * third[0] + fourth[0]) / 6,
        (first[1] + 2 * second[1] + 2 * third[1] + fourth[1]) / 6,
        (first[2] + 2 * second[2] + 2 * third[2] + fourth[2]) / 6,
        (first[3] + 2 * second[3] + 2 * third[3] + fourth[3]) / 6,
        (first[4] + 2 * second[4] + 2 * third[4] + fourth[4]) / 6,
        (first[5] + 2 * second[5] + 2 * third[5] + fourth[5]) / 6,
        (first[6] + 2 * second[6] + 2 * third[6] + fourth[6]) / 6,
        (first[7] + 2 * second[7] + 2 * third[7] + fourth[7]) / 6,
    )


@inlined
def _rates(
    car: SingleTrackConstants, brush: bool, motion: _Motion, steering: float, turning: float, wanted: float
) -> _Change:
    """What changes of a motion, a second, and the accelerations along and across the car."""
    if brush:
        return _brush_rates(car, motion, steering, wanted)
    return _linear_rates(car, motion, steering, turning, wanted)


@inlined
def _brush_rates(car: SingleTrackConstants, motion: _Motion, steering: float, wanted: float) -> _Change:
    """As `carrl.sim.tyres.Brush.rates`."""
    heading, along, across, yaw_rate = motion[2], motion[3], motion[4], motion[5]
    cos, sin, cos_steering, sin_steering = math.cos(heading), math.sin(heading), math.cos(steering), math.sin(steering)
    grip = car.friction * car.gravity
    drive = _within(_brush_drive(car, along, across, wanted), math.sqrt(1 - car.steerable * car.steerable) * grip)
    left = math.sqrt(1 - (drive / grip) * (drive / grip))
    front_load = (car.gravity * car.rear_axle - drive * car.height) / (car.gravity * (car.front_axle + car.rear_axle))
    front_across, rear_across = across + car.front_axle * yaw_rate, across - car.rear_axle * yaw_rate
    sideways = front_across * cos_steering - along * sin_steering
    ahead = along * cos_steering + front_across * sin_steering
    front = grip * front_load * _brush_force(car, sideways, ahead, car.front_stiffness, left)
    rear = grip * (1 - front_load) * _brush_force(car, rear_across, along, car.rear_stiffness, left)
    front_along = front_load * drive * cos_steering - front * sin_steering
    front_aside = front_load * drive * sin_steering + front * cos_steering
    acceleration, lateral = front_along + (1 - front_load) * drive, front_aside + rear
    return (
        along * cos - across * sin,
        along * sin + across * cos,
        yaw_rate,
        acceleration + yaw_rate * across,
        lateral - yaw_rate * along,
        (car.front_axle * front_aside - car.rear_axle * rear) * car.mass_by_inertia,
        acceleration,
        lateral,
    )


@inlined
def _brush_force(car: SingleTrackConstants, sideways: float, ahead: float, stiffness: float, left: float) -> float:
    """As `carrl.sim.tyres.Brush.force`."""
    slip = stiffness * sideways / (left * max(abs(ahead), car.slip_speed))
    room = 1 - min(abs(slip), car.full_slip) / car.full_slip
    return math.copysign(left * (1 - room * room * room), -slip)


@inlined
def _brush_drive(car: SingleTrackConstants, along: float, across: float, wanted: float) -> float:
    """As `carrl.sim.tyres.Brush.limited`."""
    energy = along * along + across * across
    if wanted >= 0:
        strongest = car.max_acceleration * car.power_speed / max(abs(along), car.power_speed)
        forward = car.ease / (2 * car.max_speed) * (car.max_speed * car.max_speed - energy)
        return min(wanted, min(strongest, forward))
    wanted = max(wanted, -car.max_acceleration)
    if car.min_speed == 0:
        return -max(min(car.ease * along, -wanted), wanted)
    if along >= 0:
        return wanted
    return max(wanted, car.ease / (2 * car.min_speed) * (car.min_speed * car.min_speed - energy))


@inlined
def _linear_rates(
    car: SingleTrackConstants, motion: _Motion, steering: float, turning: float, wanted: float
) -> _Change:
    """As `carrl.sim.tyres.Linear.rates`."""
    heading, speed, slip, yaw_rate = motion[2], motion[3], motion[4], motion[5]
    drive, a, b = _linear_drive(car, speed, wanted), car.front_axle, car.rear_axle
    if abs(speed) < car.kinematic_below:
        tan, cos = math.tan(steering), math.cos(steering)
        turn = speed / (a + b) * tan
        yaw = (drive * tan + speed * turning / (cos * cos)) / (a + b)
        return speed * math.cos(heading), speed * math.sin(heading), turn, drive, 0.0, yaw, drive, speed * turn
    front = car.front_stiffness * (car.gravity * b - drive * car.height)
    rear = car.rear_stiffness * (car.gravity * a + drive * car.height)
    yaw = a * front * steering + (b * rear - a * front) * slip - (a * a * front + b * b * rear) * yaw_rate / speed
    turn = front * steering - (rear + front) * slip + (b * rear - a * front) * yaw_rate / speed
    turn *= car.friction / (speed * (a + b))
    return (
        speed * math.cos(heading + slip),
        speed * math.sin(heading + slip),
        yaw_rate,
        drive,
        turn - yaw_rate,
        yaw * car.friction * car.mass_by_inertia / (a + b),
        drive,
        speed * turn,
    )


@inlined
def _linear_drive(car: SingleTrackConstants, speed: float, wanted: float) -> float:
    """As `carrl.sim.tyres.Linear.limited`."""
    if (speed <= car.min_speed and wanted <= 0) or (speed >= car.max_speed and wanted >= 0):
        return 0.0
    strongest = car.max_acceleration * car.power_speed / max(speed, car.power_speed)
    return min(max(wanted, -car.max_acceleration), strongest)
