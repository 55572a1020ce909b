"""The step of `carrl.sim.single_track` as machine code for the CPU, one car at a time.

All is float64 and rounded to float32 once. A car on brush tyres needs sine and cosine of its heading and
of its steering angle eight times a step; they are turned on from each other, which takes a third of the time.

Shapes: `N` cars, `S` entries of the state, `C` controls, `K` constants. Units: m, s, rad.
"""

import math
from typing import NamedTuple

import numpy as np

from carrl.machine_code import compiled, inlined

_SMALL = 0.25
_Motion = tuple[float, float, float, float, float, float]
_Change = tuple[float, float, float, float, float, float, float, float]
_Direction = tuple[float, float]


class Constants(NamedTuple):
    """What `SingleTrack.constants` lists.

    Attributes:
        has_brush_tyres: not 0 for brush tyres, 0 for linear ones.
        steering: 0 for `angle`, 1 for `rate`, 2 for `servo`.
        pedals: 0 where they give an acceleration, 1 where the driver sets a speed, 2 where the engine gives a share.
        by_euler: not 0 for Euler's integrator.
        substeps: in a step.
        substep: s.
        front_axle, rear_axle: from the centre of gravity, m.
        mass_by_inertia: 1/m^2.
        grip: friction * gravity, m/s^2.
        by_grip: 1 / grip.
        front_load: share of the weight on the front axle.
        load_transfer: what of that goes to the rear, by acceleration, s^2/m.
        front_stiffness, rear_stiffness: 1/rad.
        max_steering: rad.
        steering_rate: rad/s.
        max_acceleration: m/s^2.
        power_speed, max_speed, min_speed, slip_speed, kinematic_below: m/s.
        most_drive: acceleration that leaves enough grip to steer with, m/s^2.
        by_full_slip: 1 / the slip at which a brush slides, in stiffnesses.
        forward_ease, backward_ease: 1/m.
        braking_ease: 1/s.
        rest: m/s.
        most_spin: rad/s, and rad.
        dead_band: of the servo, rad.
        forward_gain, backward_gain: of the speed control.
    """

    has_brush_tyres: float
    steering: float
    pedals: float
    by_euler: float
    substeps: float
    substep: float
    front_axle: float
    rear_axle: float
    mass_by_inertia: float
    grip: float
    by_grip: float
    front_load: float
    load_transfer: float
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
    most_drive: float
    by_full_slip: float
    forward_ease: float
    backward_ease: float
    braking_ease: float
    rest: float
    most_spin: float
    dead_band: float
    forward_gain: float
    backward_gain: float


@compiled
def drive_single_track(state: np.ndarray, control: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """The next states [N, S], float32, of states [N, S], controls [N, C], both float32, and constants [K]."""
    c = constants
    car = Constants(
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11], c[12], c[13], c[14],
        c[15], c[16], c[17], c[18], c[19], c[20], c[21], c[22], c[23], c[24], c[25], c[26], c[27], c[28], c[29],
        c[30], c[31], c[32],
    )  # fmt: skip
    moved, state, control = np.empty_like(state), state.astype(np.float64), control.astype(np.float64)
    for row in range(len(state)):
        speed, slip, steering, steer = state[row, 3], state[row, 5], state[row, 6], control[row, 0]
        command, earlier_command = steer, steer
        if car.steering == 2:
            command, earlier_command = state[row, 9], state[row, 10]
        wanted_angle = steer * _steering_range(car, speed, c[33:])
        along, across = (speed * math.cos(slip), speed * math.sin(slip)) if car.has_brush_tyres else (speed, slip)
        motion = state[row, 0], state[row, 1], state[row, 2], along, across, state[row, 4]
        way, wheels = (math.cos(motion[2]), math.sin(motion[2])), (math.cos(steering), math.sin(steering))
        acceleration, lateral = 0.0, 0.0
        for _ in range(int(car.substeps)):
            turning = _turning(car, steering, steer, wanted_angle, earlier_command)
            wanted = _wanted(car, control[row], motion[3])
            if car.has_brush_tyres:
                change, wheels = _brush_change(car, motion, way, wheels, turning, wanted)
                way = _turned(way, car.substep * change[2])
                motion = _after(motion, change, car.substep)
            else:
                change = _linear_change(car, motion, steering, turning, wanted)
                motion = _settled(car, _after(motion, change, car.substep))
            acceleration, lateral = acceleration + change[6], lateral + change[7]
            steering += car.substep * turning
            command, earlier_command = steer, command
        speed, slip = motion[3], motion[4]
        if car.has_brush_tyres:
            speed, slip = math.hypot(motion[3], motion[4]), math.atan2(motion[4], motion[3])
            if speed < car.rest:
                speed, slip = 0.0, 0.0
        moved[row, 0], moved[row, 1] = motion[0], motion[1]
        moved[row, 2] = (motion[2] + math.pi) % (2 * math.pi) - math.pi
        moved[row, 3], moved[row, 4], moved[row, 5], moved[row, 6] = speed, motion[5], slip, steering
        moved[row, 7], moved[row, 8] = acceleration / car.substeps, lateral / car.substeps
        if car.steering == 2:
            moved[row, 9], moved[row, 10] = command, earlier_command
    return moved


@inlined
def _within(value: float, most: float) -> float:
    return max(min(value, most), -most)


@inlined
def _steering_range(car: Constants, speed: float, shape: np.ndarray) -> float:
    """As `DrivenCar.steering_range`; `shape` is its least share of the lock, lateral acceleration and slip."""
    angle = (car.front_axle + car.rear_axle) * shape[1] / (speed * speed) + shape[2]
    return max(min(angle, car.max_steering), shape[0] * car.max_steering)


@inlined
def _turning(car: Constants, steering: float, steer: float, wanted_angle: float, earlier_command: float) -> float:
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
def _wanted(car: Constants, control: np.ndarray, speed: float) -> float:
    """The acceleration that the driver asks for, m/s^2."""
    pedal = control[1]
    if len(control) == 3:
        return (pedal - control[2]) / 2 * car.max_acceleration
    if car.pedals == 2 and pedal > 0:
        return pedal * car.max_acceleration * car.power_speed / max(abs(speed), car.power_speed)
    if car.pedals != 1:
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
def _mean(first: _Change, second: _Change, third: _Change, fourth: _Change) -> _Change:
    """By Runge and Kutta's weights."""
    return (
        (first[0] + 2 * (second[0] + third[0]) + fourth[0]) * (1 / 6),
        (first[1] + 2 * (second[1] + third[1]) + fourth[1]) * (1 / 6),
        (first[2] + 2 * (second[2] + third[2]) + fourth[2]) * (1 / 6),
        (first[3] + 2 * (second[3] + third[3]) + fourth[3]) * (1 / 6),
        (first[4] + 2 * (second[4] + third[4]) + fourth[4]) * (1 / 6),
        (first[5] + 2 * (second[5] + third[5]) + fourth[5]) * (1 / 6),
        (first[6] + 2 * (second[6] + third[6]) + fourth[6]) * (1 / 6),
        (first[7] + 2 * (second[7] + third[7]) + fourth[7]) * (1 / 6),
    )


@inlined
def _turned(direction: _Direction, angle: float) -> _Direction:
    """Cosine and sine of a direction turned on, to 1e-14: by their series where the angle is small."""
    if abs(angle) < _SMALL:
        square = angle * angle
        cos = 1 - square * (
            1 / 2 - square * (1 / 24 - square * (1 / 720 - square * (1 / 40320 - square * (1 / 3628800))))
        )
        sin = angle * (1 - square * (1 / 6 - square * (1 / 120 - square * (1 / 5040 - square * (1 / 362880)))))
    else:
        cos, sin = math.cos(angle), math.sin(angle)
    return direction[0] * cos - direction[1] * sin, direction[1] * cos + direction[0] * sin


@inlined
def _brush_change(
    car: Constants, motion: _Motion, way: _Direction, wheels: _Direction, turning: float, wanted: float
) -> tuple[_Change, _Direction]:
    """What changes in a substep, a second, and the direction of the front wheels after it.

    `way` and `wheels` are cosine and sine of the heading and of the steering angle before it.
    """
    time = car.substep
    half = time / 2
    middle = _turned(wheels, half * turning)
    end = _turned(middle, half * turning)
    first = _brush_rates(car, motion, way, wheels, wanted)
    second = _brush_rates(car, _after(motion, first, half), _turned(way, half * first[2]), middle, wanted)
    third = _brush_rates(car, _after(motion, second, half), _turned(way, half * second[2]), middle, wanted)
    fourth = _brush_rates(car, _after(motion, third, time), _turned(way, time * third[2]), end, wanted)
    return _mean(first, second, third, fourth), end


@inlined
def _brush_rates(car: Constants, motion: _Motion, way: _Direction, wheels: _Direction, wanted: float) -> _Change:
    """As `carrl.sim.tyres.Brush.rates`."""
    along, across, yaw_rate = motion[3], motion[4], motion[5]
    drive = _within(_brush_drive(car, along, across, wanted), car.most_drive)
    used = drive * car.by_grip
    left = math.sqrt(1 - used * used)
    front_across, rear_across = across + car.front_axle * yaw_rate, across - car.rear_axle * yaw_rate
    front_along = along * wheels[0] + front_across * wheels[1]
    front_aside = front_across * wheels[0] - along * wheels[1]
    front_drive, rear_drive = _at_wheel(car, front_along, drive), _at_wheel(car, along, drive)
    front_load = car.front_load - rear_drive * car.load_transfer
    front = car.grip * front_load * _brush_force(car, front_aside, front_along, car.front_stiffness, left)
    rear = car.grip * (1 - front_load) * _brush_force(car, rear_across, along, car.rear_stiffness, left)
    front_pull = front_load * front_drive * wheels[0] - front * wheels[1]
    front_push = front_load * front_drive * wheels[1] + front * wheels[0]
    acceleration, lateral = front_pull + (1 - front_load) * rear_drive, front_push + rear
    return (
        along * way[0] - across * way[1],
        along * way[1] + across * way[0],
        yaw_rate,
        acceleration + yaw_rate * across,
        lateral - yaw_rate * along,
        (car.front_axle * front_push - car.rear_axle * rear) * car.mass_by_inertia,
        acceleration,
        lateral,
    )


@inlined
def _brush_force(car: Constants, sideways: float, ahead: float, stiffness: float, left: float) -> float:
    """As `carrl.sim.tyres.Brush.force`."""
    slip = stiffness * sideways / (left * max(abs(ahead), car.slip_speed))
    room = max(1 - abs(slip) * car.by_full_slip, 0.0)
    return math.copysign(left * (1 - room * room * room), -slip)


@inlined
def _brush_drive(car: Constants, along: float, across: float, wanted: float) -> float:
    """As `carrl.sim.tyres.Brush.limited`."""
    energy = along * along + across * across
    if wanted >= 0:
        strongest = car.max_acceleration * car.power_speed / max(abs(along), car.power_speed)
        forward = car.forward_ease * (car.max_speed * car.max_speed - energy)
        return min(wanted, min(strongest, forward))
    wanted = max(wanted, -car.max_acceleration)
    if car.min_speed == 0 or along >= 0:
        return wanted
    return max(wanted, car.backward_ease * (car.min_speed * car.min_speed - energy))


@inlined
def _at_wheel(car: Constants, speed: float, drive: float) -> float:
    """As `carrl.sim.tyres.Brush.at_wheel`."""
    if drive >= 0 or car.min_speed < 0:
        return drive
    return -max(min(car.braking_ease * speed, -drive), drive)


@inlined
def _linear_change(car: Constants, motion: _Motion, steering: float, turning: float, wanted: float) -> _Change:
    """What changes in a substep, a second."""
    time = car.substep
    first = _linear_rates(car, motion, steering, turning, wanted)
    if car.by_euler:
        return first
    middle = steering + time / 2 * turning
    second = _linear_rates(car, _after(motion, first, time / 2), middle, turning, wanted)
    third = _linear_rates(car, _after(motion, second, time / 2), middle, turning, wanted)
    fourth = _linear_rates(car, _after(motion, third, time), steering + time * turning, turning, wanted)
    return _mean(first, second, third, fourth)


@inlined
def _linear_rates(car: Constants, motion: _Motion, steering: float, turning: float, wanted: float) -> _Change:
    """As `carrl.sim.tyres.Linear.rates`."""
    heading, speed, slip, yaw_rate = motion[2], motion[3], motion[4], motion[5]
    drive, a, b = _linear_drive(car, speed, wanted), car.front_axle, car.rear_axle
    if abs(speed) < car.kinematic_below:
        tan, cos = math.tan(steering), math.cos(steering)
        turn = speed / (a + b) * tan
        yaw = (drive * tan + speed * turning / (cos * cos)) / (a + b)
        return speed * math.cos(heading), speed * math.sin(heading), turn, drive, 0.0, yaw, drive, speed * turn
    front = car.front_stiffness * car.grip * (car.front_load - drive * car.load_transfer)
    rear = car.rear_stiffness * car.grip * (1 - car.front_load + drive * car.load_transfer)
    yaw = a * front * steering + (b * rear - a * front) * slip - (a * a * front + b * b * rear) * yaw_rate / speed
    turn = front * steering - (rear + front) * slip + (b * rear - a * front) * yaw_rate / speed
    return (
        speed * math.cos(heading + slip),
        speed * math.sin(heading + slip),
        yaw_rate,
        drive,
        turn / speed - yaw_rate,
        yaw * car.mass_by_inertia,
        drive,
        turn,
    )


@inlined
def _linear_drive(car: Constants, speed: float, wanted: float) -> float:
    """As `carrl.sim.tyres.Linear.limited`."""
    if (speed <= car.min_speed and wanted <= 0) or (speed >= car.max_speed and wanted >= 0):
        return 0.0
    strongest = car.max_acceleration * car.power_speed / max(speed, car.power_speed)
    return min(max(wanted, -car.max_acceleration), strongest)


@inlined
def _settled(car: Constants, motion: _Motion) -> _Motion:
    """As `carrl.sim.tyres.Linear.settled`."""
    speed, most = max(min(motion[3], car.max_speed), car.min_speed), car.most_spin
    return motion[0], motion[1], motion[2], speed, _within(motion[4], most), _within(motion[5], most)
