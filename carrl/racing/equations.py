"""The equations of `carrl.sim.tyres` for CasADi: the same motion and the same rates, of one car, as expressions.

They hold where the driver asks for no more than engine, brakes and tyres give, where the wheels roll forward faster
than brakes ease off, and above the speed below which linear tyres roll where they point. Within that they are the
simulator's to rounding, which a test shows.

A motion is x, y, heading, two numbers that say how the centre of gravity moves, and the yaw rate; see
`carrl.sim.tyres`. Units: m, s, rad.
"""

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

from carrl.errors import ConfigError
from carrl.sim.driven import GRAVITY
from carrl.sim.single_track import SingleTrack
from carrl.sim.tyres import FULL_SLIP

Expression = Any
"""One of CasADi's, or a number."""
Rates = Callable[[SingleTrack, Sequence[Expression], Expression, Expression], list[Expression]]


def casadi() -> ModuleType:
    """The package, imported where it is needed: it is an extra.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import casadi as found
    except ImportError as error:
        raise ConfigError(
            "the minimum lap time needs casadi, which is not installed; pip install 'carrl[racing]'"
        ) from error
    module: ModuleType = found
    return module


def brush_rates(
    car: SingleTrack, motion: Sequence[Expression], steering: Expression, drive: Expression
) -> list[Expression]:
    """What changes of a motion on brush tyres, a second: `carrl.sim.tyres.Brush.rates`."""
    ca = casadi()
    _, _, heading, along, across, yaw_rate = motion
    cos, sin, cos_steering, sin_steering = ca.cos(heading), ca.sin(heading), ca.cos(steering), ca.sin(steering)
    grip = car.friction * GRAVITY
    left = ca.sqrt(1 - (drive / grip) ** 2)
    front_across, rear_across = across + car.front_axle * yaw_rate, across - car.rear_axle * yaw_rate
    front_along = along * cos_steering + front_across * sin_steering
    front_aside = front_across * cos_steering - along * sin_steering
    front_load = (GRAVITY * car.rear_axle - drive * car.height) / (GRAVITY * car.wheelbase)

    def force(sideways: Expression, ahead: Expression, stiffness: float) -> Expression:
        slip = stiffness / left * sideways / ca.fmax(ca.fabs(ahead), car.slip_speed)
        return -left * ca.sign(slip) * (1 - (1 - ca.fmin(ca.fabs(slip), FULL_SLIP) / FULL_SLIP) ** 3)

    front = grip * front_load * force(front_aside, front_along, car.front_stiffness)
    rear = grip * (1 - front_load) * force(rear_across, along, car.rear_stiffness)
    front_pull = front_load * drive * cos_steering - front * sin_steering
    front_push = front_load * drive * sin_steering + front * cos_steering
    return [
        along * cos - across * sin,
        along * sin + across * cos,
        yaw_rate,
        front_pull + (1 - front_load) * drive + yaw_rate * across,
        front_push + rear - yaw_rate * along,
        (car.front_axle * front_push - car.rear_axle * rear) * (car.mass / car.yaw_inertia),
    ]


def linear_rates(
    car: SingleTrack, motion: Sequence[Expression], steering: Expression, drive: Expression
) -> list[Expression]:
    """What changes of a motion on linear tyres, a second: `carrl.sim.tyres.Linear.rates`."""
    ca = casadi()
    _, _, heading, speed, slip, yaw_rate = motion
    a, b = car.front_axle, car.rear_axle
    front = car.front_stiffness * (GRAVITY * b - drive * car.height)
    rear = car.rear_stiffness * (GRAVITY * a + drive * car.height)
    by_slip, by_yaw = b * rear - a * front, a * a * front + b * b * rear
    yaw = a * front * steering + by_slip * slip - by_yaw * yaw_rate / speed
    turn = front * steering - (rear + front) * slip + by_slip * yaw_rate / speed
    return [
        speed * ca.cos(heading + slip),
        speed * ca.sin(heading + slip),
        yaw_rate,
        drive,
        car.friction / (speed * car.wheelbase) * turn - yaw_rate,
        car.friction * car.mass / (car.yaw_inertia * car.wheelbase) * yaw,
    ]


RATES: dict[str, Rates] = {"brush": brush_rates, "linear": linear_rates}
