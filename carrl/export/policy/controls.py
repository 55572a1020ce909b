"""What the controls of a vehicle, -1 to 1, are in physical units: a steering angle in rad, a speed in m/s."""

import math
from functools import singledispatch
from typing import Any, NamedTuple

from carrl.sim.driven import LEAST_RANGE, RANGE_LATERAL, RANGE_SLIP
from carrl.sim.kinematic import Kinematic
from carrl.sim.single_track import SingleTrack
from carrl.sim.vehicle import Bicycle, Vehicle, VehicleModel


class ControlQuantity(NamedTuple):
    """What one control stands for; between the three values it is a straight line.

    Attributes:
        name: of the control.
        quantity: such as "steering angle".
        unit: of it.
        at: its values where the control is -1, 0 and 1.
        steering_range: what they are multiplied by, if it is the speed-scaled range of a car's steering, rad: at a
            speed v, m/s, `lateral / v^2 + slip`, but from `least` to `most`.
    """

    name: str
    quantity: str
    unit: str
    at: tuple[float, float, float]
    steering_range: dict[str, float] | None = None

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {**self._asdict(), "at": list(self.at)}


@singledispatch
def control_quantities(vehicle: VehicleModel) -> tuple[ControlQuantity, ...]:
    """What each control of a vehicle stands for, in their order; of a model that is not CarRL's, a number.

    A model of one's own may say more: `@control_quantities.register`.
    """
    return tuple(ControlQuantity(name, "control", "1", (-1.0, 0.0, 1.0)) for name in vehicle.control_names)


@control_quantities.register
def _(vehicle: Vehicle) -> tuple[ControlQuantity, ...]:
    return (_symmetric("steer", "yaw rate", "rad/s", vehicle.yaw_per_step / vehicle.time_step),)


@control_quantities.register
def _(vehicle: Bicycle) -> tuple[ControlQuantity, ...]:
    return (_symmetric("steer", "steering angle", "rad", math.radians(vehicle.steering_angle)),)


@control_quantities.register
def _(vehicle: Kinematic) -> tuple[ControlQuantity, ...]:
    return _steering(vehicle), *_pedals(vehicle.pedals, vehicle.max_acceleration, vehicle.max_braking)


@control_quantities.register
def _(vehicle: SingleTrack) -> tuple[ControlQuantity, ...]:
    if vehicle.pedals == "speed":
        return _steering(vehicle), ControlQuantity("speed", "speed", "m/s", (vehicle.min_speed, 0.0, vehicle.max_speed))
    return _steering(vehicle), *_pedals(vehicle.pedals, vehicle.max_acceleration, vehicle.max_acceleration)


def _symmetric(name: str, quantity: str, unit: str, most: float) -> ControlQuantity:
    return ControlQuantity(name, quantity, unit, (-most, 0.0, most))


def _steering(vehicle: Kinematic | SingleTrack) -> ControlQuantity:
    """Of the front wheels, left positive."""
    if vehicle.steering == "rate":
        return _symmetric("steer", "steering rate", "rad/s", vehicle.steering_rate)
    if vehicle.steering == "servo":
        return _symmetric("steer", "steering angle", "rad", vehicle.max_steering)
    steering_range = {
        "lateral": vehicle.wheelbase * RANGE_LATERAL,
        "slip": RANGE_SLIP,
        "least": LEAST_RANGE * vehicle.max_steering,
        "most": vehicle.max_steering,
    }
    return _symmetric("steer", "steering angle", "rad", 1.0)._replace(steering_range=steering_range)


def _pedals(pedals: str, drive: float, brake: float) -> tuple[ControlQuantity, ...]:
    if pedals == "one":
        return (ControlQuantity("pedal", "acceleration asked for", "m/s^2", (-brake, 0.0, drive)),)
    if pedals == "power":
        return (ControlQuantity("pedal", "share of the engine's power, below 0 of the brakes", "1", (-1.0, 0.0, 1.0)),)
    return tuple(
        ControlQuantity(name, "share of the pedal's way", "1", (0.0, 0.5, 1.0)) for name in ("throttle", "brake")
    )
