"""The car: constant speed, three actions, and a disc for a body.

Shapes: `A` actions, `B` cars. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import torch
from torch import Tensor

from carrl.errors import ConfigError

LEAST, MOST = 1e-9, 1e9
"""Bounds of every parameter of a car, m, m/s, s or degrees; far off, so that none of their products overflows."""


class Action(IntEnum):
    """What the driver can ask for; the car moves on in all three."""

    FORWARD = 0
    LEFT = 1
    RIGHT = 2


class Manoeuvre(NamedTuple):
    """How one step of an action moves a car, whatever its pose.

    Attributes:
        distance: from where it was to where it is then, m; negative if that lies against the bearing.
        bearing: of that way from the heading before, rad.
        yaw: change of heading, rad.
    """

    distance: float
    bearing: float
    yaw: float

    def mirrored(self) -> "Manoeuvre":
        """The same to the other side."""
        return Manoeuvre(self.distance, -self.bearing, -self.yaw)


class VehicleModel(ABC):
    """What all cars have in common; a model of one says what its actions do."""

    speed: float
    time_step: float
    body_radius: float

    def __post_init__(self) -> None:
        """Raises ConfigError unless every value is a positive number, neither tiny nor huge."""
        for name, value in vars(self).items():
            if isinstance(value, bool) or not (isinstance(value, int | float) and 0 < value < math.inf):
                raise ConfigError(f"vehicle.{name} is {value}; it must be a positive number")
            if not LEAST <= value <= MOST:
                raise ConfigError(f"vehicle.{name} is {value}; it must lie between {LEAST:g} and {MOST:g}")

    @property
    def forward(self) -> Manoeuvre:
        """What a step of the action forward does."""
        return Manoeuvre(self.step_length, 0.0, 0.0)

    @property
    @abstractmethod
    def left(self) -> Manoeuvre:
        """What a step of the action left does; right is its mirror image."""

    @property
    def manoeuvres(self) -> tuple[Manoeuvre, ...]:
        """What a step of each `Action` does."""
        return self.forward, self.left, self.left.mirrored()

    @property
    def step_length(self) -> float:
        """Distance driven in one step, m."""
        return self.speed * self.time_step

    def move(self, pose: Tensor, action: Tensor) -> Tensor:
        """Drives one step.

        Args:
            pose: x m, y m, heading rad, [B, 3].
            action: values of `Action`, [B], int64.

        Returns:
            The pose one step later, [B, 3], heading in [-pi, pi).
        """
        distance, bearing, yaw = pose.new_tensor(self.manoeuvres)[action].unbind(-1)
        direction, heading = pose[:, 2] + bearing, pose[:, 2] + yaw
        x = pose[:, 0] + distance * direction.cos()
        y = pose[:, 1] + distance * direction.sin()
        return torch.stack([x, y, torch.remainder(heading + math.pi, 2 * math.pi) - math.pi], dim=-1)


@dataclass(frozen=True)
class Vehicle(VehicleModel):
    """Turns on the spot by a fixed angle, then drives straight along its new heading (semi-implicit Euler).

    A car that keeps turning therefore drives a regular polygon with sides of `step_length`.

    Attributes:
        speed: m/s, the same in every step.
        time_step: simulated time of one step, s.
        turn_radius: radius of the circle driven while turning, m.
        body_radius: radius of the disc that must not touch a wall, m.
    """

    speed: float = 10.0
    time_step: float = 0.1
    turn_radius: float = 7.2
    body_radius: float = 0.5

    @property
    def yaw_per_step(self) -> float:
        """Change of heading in one turning step, rad."""
        return self.step_length / self.turn_radius

    @property
    def left(self) -> Manoeuvre:
        """Turn first, then drive."""
        return Manoeuvre(self.step_length, self.yaw_per_step, self.yaw_per_step)


@dataclass(frozen=True)
class Bicycle(VehicleModel):
    """The kinematic bicycle, seen from half-way between its axles, its front wheel turned by one angle or straight.

    Each step is the exact arc of a circle, with the car's middle sliding along it at an angle to the heading. Only for
    collisions and gates the way is the arc's chord.

    Attributes:
        speed: of the car's middle, m/s, the same in every step.
        time_step: simulated time of one step, s.
        wheelbase: between the axles, m.
        steering_angle: of the front wheel in a turn, degrees.
        body_radius: radius of the disc about the car's middle that must not touch a wall, m.

    Source: Rajamani, "Vehicle Dynamics and Control" (2012), section 2.2.
    """

    speed: float = 10.0
    time_step: float = 0.1
    wheelbase: float = 1.0
    steering_angle: float = 8.0
    body_radius: float = 0.5

    def __post_init__(self) -> None:
        """Raises ConfigError unless every value is a positive number and the wheel can be turned so far."""
        super().__post_init__()
        if self.steering_angle >= 90:
            raise ConfigError(f"vehicle.steering_angle is {self.steering_angle}; it must be less than 90 degrees")

    @property
    def slip_angle(self) -> float:
        """Of the way of the car's middle against its heading, in a turn to the left, rad."""
        return math.atan(math.tan(math.radians(self.steering_angle)) / 2)

    @property
    def turn_radius(self) -> float:
        """Of the circle that the car's middle drives, m."""
        return self.wheelbase / (2 * math.sin(self.slip_angle))

    @property
    def left(self) -> Manoeuvre:
        """The chord of the arc."""
        yaw = self.step_length / self.turn_radius
        return Manoeuvre(2 * self.turn_radius * math.sin(yaw / 2), self.slip_angle + yaw / 2, yaw)
