"""The car: constant speed, three actions, and a disc for a body.

Shapes: `B` cars. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

import torch
from torch import Tensor

from carrl.errors import ConfigError


class Action(IntEnum):
    """What the driver can ask for; the car moves on in all three."""

    FORWARD = 0
    LEFT = 1
    RIGHT = 2


@dataclass(frozen=True)
class Vehicle:
    """How the car moves.

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

    def __post_init__(self) -> None:
        """Raises ConfigError unless every value is a positive number."""
        for name, value in vars(self).items():
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
                raise ConfigError(f"vehicle.{name} is {value}; it must be a positive number")

    @property
    def step_length(self) -> float:
        """Distance driven in one step, m."""
        return self.speed * self.time_step

    @property
    def yaw_per_step(self) -> float:
        """Change of heading in one turning step, rad."""
        return self.step_length / self.turn_radius

    def move(self, pose: Tensor, action: Tensor) -> Tensor:
        """Turns the heading first, then drives straight along it (semi-implicit Euler).

        A car that keeps turning therefore drives a regular polygon with sides of `step_length`.

        Args:
            pose: x m, y m, heading rad, [B, 3].
            action: values of `Action`, [B], int64.

        Returns:
            The pose one step later, [B, 3], heading in [-pi, pi).
        """
        turn = (action == Action.LEFT).to(pose.dtype) - (action == Action.RIGHT).to(pose.dtype)
        heading = pose[:, 2] + self.yaw_per_step * turn
        x = pose[:, 0] + self.step_length * heading.cos()
        y = pose[:, 1] + self.step_length * heading.sin()
        return torch.stack([x, y, torch.remainder(heading + math.pi, 2 * math.pi) - math.pi], dim=-1)
