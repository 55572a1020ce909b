"""What the driver is told of the car's own motion: entries of its state, its last controls, contact with a wall.

Shapes: `N` cars.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.sim.sensor import Sensor
from carrl.task.action import ActionMap
from carrl.task.checks import number
from carrl.task.episode import ObservationContext
from carrl.task.observation import Part

MOST_UNIT = 1e9
WIDE = 1e9
"""Bound of values that have none of their own; Gymnasium warns of bounds that are infinite."""


def check_unit(unit: object, term: str) -> None:
    """Raises ConfigError unless the unit is a positive number."""
    number(f"observation: unit of {term}", unit, 1 / MOST_UNIT, MOST_UNIT, "a positive number")


@dataclass(frozen=True)
class StateEntry:
    """One entry of the vehicle's state, such as its speed.

    Attributes:
        entry: its name, such as speed, slip, yaw_rate, steering, acceleration or lateral_acceleration.
        unit: what counts as 1, in m/s, rad, rad/s or m/s^2.
    """

    entry: str
    unit: float = 1.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a unit that is not positive."""
        check_unit(self.unit, "StateEntry")

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value."""
        return Part(name, 1, -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        """In the unit."""
        return context.value(self.entry)[:, None] / self.unit


@dataclass(frozen=True)
class Velocity:
    """The velocity's components along the heading and to the left of it.

    Attributes:
        unit: what counts as 1, m/s.
    """

    unit: float = 1.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a unit that is not positive."""
        check_unit(self.unit, "Velocity")

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """Two values."""
        return Part(name, 2, -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        """From the speed and the slip angle."""
        speed, slip = context.value("speed"), context.value("slip")
        return torch.stack([speed * slip.cos(), speed * slip.sin()], dim=-1) / self.unit


@dataclass(frozen=True)
class LastControl:
    """One control of the step before.

    Attributes:
        control: its name, such as steer.
    """

    control: str = "steer"

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value.

        Raises:
            ConfigError: the vehicle has no such control.
        """
        if self.control not in action.control_names:
            raise ConfigError(
                f"observation.{name}.control is {self.control!r}; the vehicle has {', '.join(action.control_names)}"
            )
        return Part(name, 1, -1.0, 1.0)

    def __call__(self, context: ObservationContext) -> Tensor:
        """Within -1 and 1."""
        index = list(context.action.control_names).index(self.control)
        return context.action.controls(context.state.last_action)[:, index : index + 1]


@dataclass(frozen=True)
class WallContact:
    """1 where the body touched a wall in the last step, otherwise 0."""

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value."""
        return Part(name, 1, 0.0, 1.0)

    def __call__(self, context: ObservationContext) -> Tensor:
        """0 at a start."""
        contact = context.state.contact
        return context.ranges.new_zeros(len(context.ranges), 1) if contact is None else contact[:, None].float()
