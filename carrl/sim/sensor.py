"""The distance sensors: rays that fan out from the middle of the car, or from a place ahead of it.

Shapes: `B` cars, `R` rays.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from carrl.config import is_whole_number
from carrl.errors import ConfigError
from carrl.rows import scalar

MOST_RAYS = 4096
"""Far more than any scanner has; a batch of so many readings still fits into memory."""


@dataclass(frozen=True)
class Sensor:
    """A fan of rays, spread evenly, and symmetrically about the heading unless it is turned.

    Attributes:
        rays: how many.
        field_of_view: angle between the first and the last ray, degrees.
        max_range: distance at which a ray ends and reads 1, m.
        noise: standard deviation of the normal error of a distance, m.
        dropout: probability that a ray comes back from nothing and reads 1.
        mount: how far ahead of the car's middle the rays start, m.
        turn: from the heading to the middle of the fan, degrees counter-clockwise.
    """

    rays: int = 7
    field_of_view: float = 180.0
    max_range: float = 10.0
    noise: float = 0.0
    dropout: float = 0.0
    mount: float = 0.0
    turn: float = 0.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a fan that cannot be built."""
        if not (is_whole_number(self.rays) and 1 <= self.rays <= MOST_RAYS):
            raise ConfigError(f"sensor.rays is {self.rays}; it must be a whole number from 1 to {MOST_RAYS}")
        if not (_is_number(self.field_of_view) and 0 < self.field_of_view < 360):
            raise ConfigError(f"sensor.field_of_view is {self.field_of_view}; it must lie between 0 and 360 degrees")
        if not (_is_number(self.max_range) and self.max_range > 0):
            raise ConfigError(f"sensor.max_range is {self.max_range}; it must be a positive number of metres")
        if not (_is_number(self.noise) and self.noise >= 0):
            raise ConfigError(f"sensor.noise is {self.noise}; it must be a number of metres of at least 0")
        if not (_is_number(self.dropout) and 0 <= self.dropout <= 1):
            raise ConfigError(f"sensor.dropout is {self.dropout}; it must lie between 0 and 1")
        if not _is_number(self.mount):
            raise ConfigError(f"sensor.mount is {self.mount}; it must be a number of metres")
        if not (_is_number(self.turn) and -180 <= self.turn <= 180):
            raise ConfigError(f"sensor.turn is {self.turn}; it must lie between -180 and 180 degrees")

    @property
    def angles(self) -> Tensor:
        """Directions of the rays, [R], float32, rad counter-clockwise from the heading: right to left."""
        turn = math.radians(self.turn)
        if self.rays == 1:
            return torch.full((1,), turn)
        half = math.radians(self.field_of_view) / 2
        return torch.linspace(turn - half, turn + half, self.rays)

    @property
    def is_exact(self) -> bool:
        """Whether it always finds the true distances."""
        return self.noise == 0 and self.dropout == 0

    def readings(self, ranges: Tensor) -> Tensor:
        """Distances [..., R], m, as shares of the range, in 0..1."""
        return ranges / self._range

    @cached_property
    def _range(self) -> Tensor:
        return scalar(float(self.max_range))

    def err(self, ranges: Tensor, errors: Tensor, chances: Tensor) -> Tensor:
        """The distances that the sensor finds instead of the true ones.

        Args:
            ranges: true distances, [B, R], m.
            errors: drawn from the standard normal distribution, [B, R].
            chances: drawn evenly from 0..1, [B, R].

        Returns:
            [B, R], m, in [0, max_range].
        """
        found = (ranges + self.noise * errors).clamp(0, self.max_range)
        return torch.where(chances < self.dropout, self.max_range, found)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
