"""The distance sensors: rays that fan out from the middle of the car."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.errors import ConfigError


@dataclass(frozen=True)
class Sensor:
    """A fan of rays, spread evenly and symmetrically about the heading.

    Attributes:
        rays: how many.
        field_of_view: angle between the first and the last ray, degrees.
        max_range: distance at which a ray ends and reads 1, m.
    """

    rays: int = 7
    field_of_view: float = 180.0
    max_range: float = 10.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a fan that cannot be built."""
        if not (isinstance(self.rays, int) and self.rays >= 1):
            raise ConfigError(f"sensor.rays is {self.rays}; it must be a whole number of at least 1")
        if not (isinstance(self.field_of_view, int | float) and 0 < self.field_of_view < 360):
            raise ConfigError(f"sensor.field_of_view is {self.field_of_view}; it must lie between 0 and 360 degrees")
        if not (isinstance(self.max_range, int | float) and math.isfinite(self.max_range) and self.max_range > 0):
            raise ConfigError(f"sensor.max_range is {self.max_range}; it must be a positive number of metres")

    @property
    def angles(self) -> Tensor:
        """Directions of the rays, [R], float32, rad counter-clockwise from the heading: right to left."""
        if self.rays == 1:
            return torch.zeros(1)
        half = math.radians(self.field_of_view) / 2
        return torch.linspace(-half, half, self.rays)
