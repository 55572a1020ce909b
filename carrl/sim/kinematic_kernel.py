"""The step of `carrl.sim.kinematic` as machine code for the CPU, one car at a time.

All is float64 and rounded to float32 once. Shapes: `N` cars, `S` entries of the state, `C` controls, `K` constants, in
the order in which the vehicle lists them.
"""

import math

import numpy as np

from carrl.machine_code import compiled, inlined


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
