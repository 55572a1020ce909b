"""A car on brush tyres from the forces of its wheels, one car in plain numbers, by SciPy's most accurate integrator.

It is written in the ground's frame, with complex numbers for directions.
"""

import cmath
import math

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81


def tyre(moves, stiffness, load, friction, along, slip_speed):
    """Lateral force, N, of a wheel that moves so (ahead + i left, m/s) under a load and a force along it, N."""
    most = math.sqrt((friction * load) ** 2 - along**2)
    slip = abs(moves.imag) / max(abs(moves.real), slip_speed)
    bend = stiffness * friction * load * slip / most
    share = bend - bend**2 / 3 + bend**3 / 27 if bend < 3 else 1.0
    return -math.copysign(share * most, moves.imag)


def pedal(car, ahead, wanted, speed):
    """The acceleration, m/s^2, that engine or brakes can give."""
    engine = car.max_acceleration * min(1.0, car.power_speed / max(abs(ahead), 1e-9))
    near_top = 20 * (car.max_speed - speed) * (car.max_speed + speed) / (2 * car.max_speed)
    given = min(wanted, engine, near_top) if wanted >= 0 else wanted
    most = math.sqrt(0.96) * car.friction * GRAVITY
    return min(max(given, -most), most)


def at_wheel(given, ahead):
    """The acceleration by a wheel that rolls with this speed; the brakes ease off within a twentieth of a second."""
    return given if given >= 0 else math.copysign(min(20 * abs(ahead), -given), -ahead)


def changes(car, state, steering, wanted):
    """Of x, y, heading, speed east, speed north, yaw rate."""
    _, _, heading, east, north, yaw_rate = state
    forward, velocity = cmath.exp(1j * heading), complex(east, north)
    ahead = (velocity / forward).real
    given = pedal(car, ahead, wanted, abs(velocity))
    weight = car.mass * GRAVITY
    shifted = car.mass * at_wheel(given, ahead) * car.height
    front_load = (weight * car.rear_axle - shifted) / (car.front_axle + car.rear_axle)
    force, moment = 0j, 0.0
    for place, angle, load, stiffness in (
        (car.front_axle, steering, front_load, car.front_stiffness),
        (-car.rear_axle, 0.0, weight - front_load, car.rear_stiffness),
    ):
        points = forward * cmath.exp(1j * angle)
        moves = (velocity + 1j * yaw_rate * place * forward) / points
        aside = tyre(moves, stiffness, load, car.friction, given * load / GRAVITY, car.slip_speed)
        pull = points * complex(at_wheel(given, moves.real) * load / GRAVITY, aside)
        force += pull
        moment += place * (pull / forward).imag
    acceleration = force / car.mass
    return [east, north, yaw_rate, acceleration.real, acceleration.imag, moment / car.yaw_inertia]


def drive(car, start, controls, time_step):
    """The motion [6] after a row of (steering rate, rad/s, wanted acceleration, m/s^2), and the steering angle."""
    motion, steering = np.array(start[:6], dtype=float), start[6]
    for rate, wanted in controls:
        found = solve_ivp(
            lambda t, now, rate=rate, wanted=wanted, begin=steering: changes(car, now, begin + rate * t, wanted),
            (0, time_step),
            motion,
            method="DOP853",
            rtol=1e-11,
            atol=1e-11,
        )
        motion, steering = found.y[:, -1], steering + rate * time_step
    return motion, steering
