"""What the driver is told, composed of terms: what its sensors read, what it did last.

Shapes: `N` cars, `R` rays, `O` values of an observation.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Protocol

import torch
from torch import Tensor

from carrl.config import is_whole_number
from carrl.errors import ConfigError
from carrl.sim.sensor import Sensor
from carrl.task.action import ActionMap
from carrl.task.episode import ObservationContext

MOST_SCANS = 100


class Part(NamedTuple):
    """Where a term stands in an observation.

    Attributes:
        name: of the term.
        width: how many values.
        low: the least value.
        high: the largest value.
    """

    name: str
    width: int
    low: float
    high: float


class ObservationTerm(Protocol):
    """A pure function of a moment, but for what it draws from the moment's own random numbers.

    A term that looks at the context's `place` or `seen`, which cost time, has an attribute `needs` with these names.
    """

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """How many values it has and how large they may be; `name` is what the configuration calls it."""

    def __call__(self, context: ObservationContext) -> Tensor:
        """The values, [N, width], float32."""


@dataclass(frozen=True)
class Rays:
    """Distance along each ray / the sensor's range, in 0..1, right to left, as the sensor reads it."""

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value a ray."""
        return Part(name, sensor.rays, 0.0, 1.0)

    def __call__(self, context: ObservationContext) -> Tensor:
        """With the sensor's noise and dropout, drawn from the cars' own streams; an exact one draws nothing."""
        sensor, ranges, streams, wanted = context.simulator.sensor, context.ranges, context.streams, context.wanted
        if sensor.is_exact:
            return sensor.readings(ranges)
        draws = streams.normal(sensor.rays, wanted=wanted), streams.uniform(sensor.rays, wanted=wanted)
        errors, chances = (draw if wanted is None else draw[wanted] for draw in draws)
        return sensor.readings(sensor.err(ranges, errors.to(ranges), chances.to(ranges)))


@dataclass(frozen=True)
class Scans(Rays):
    """The last scans of the rays, the newest first; at a start the first one in the place of those that were not.

    Attributes:
        count: how many.
    """

    needs: ClassVar[tuple[str, ...]] = ("seen",)
    count: int = 2

    def __post_init__(self) -> None:
        """Raises ConfigError for a number out of its range."""
        if not (is_whole_number(self.count) and 1 <= self.count <= MOST_SCANS):
            raise ConfigError(
                f"observation: count of Scans is {self.count}; it must be a whole number from 1 to {MOST_SCANS}"
            )

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value a ray and scan."""
        return Part(name, self.count * sensor.rays, 0.0, 1.0)

    def __call__(self, context: ObservationContext) -> Tensor:
        """As the sensor read them."""
        newest = super().__call__(context)
        if context.seen is None:
            return newest.repeat(1, self.count)
        return torch.cat([newest, context.seen[:, : -newest.shape[1]]], dim=-1)


@dataclass(frozen=True)
class LastAction:
    """The action of the step before: one-hot, or if it is continuous its controls."""

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """As many values as the action map encodes."""
        return Part(name, action.features, 0.0 if action.first.dtype == torch.int64 else -1.0, 1.0)

    def __call__(self, context: ObservationContext) -> Tensor:
        """As the action map encodes it."""
        return context.action.encode(context.state.last_action)


@dataclass(frozen=True)
class Observation:
    """Terms side by side in their order.

    Attributes:
        terms: by name, at least one.
    """

    terms: Mapping[str, ObservationTerm]

    def __post_init__(self) -> None:
        """Raises ConfigError where there is nothing to see."""
        if not self.terms:
            raise ConfigError("observation has no terms; name at least one, such as rays")
        for name, term in self.terms.items():
            if not callable(getattr(term, "part", None)):
                raise ConfigError(f"observation.{name} has no method part(name, sensor, action), which says its width")

    def parts(self, sensor: Sensor, action: ActionMap) -> tuple[Part, ...]:
        """Where each term stands."""
        return tuple(term.part(name, sensor, action) for name, term in self.terms.items())

    def __call__(self, context: ObservationContext) -> Tensor:
        """The observations, [N, O], float32; the context's `seen` is the whole observation of the step before."""
        if context.seen is None:
            values = [term(context) for term in self.terms.values()]
        else:
            widths = [part.width for part in self.parts(context.simulator.sensor, context.action)]
            told = zip(self.terms.values(), context.seen.split(widths, dim=-1), strict=True)
            values = [term(replace(context, seen=seen)) for term, seen in told]
        return values[0] if len(values) == 1 else torch.cat(values, dim=-1)


def rays_only() -> Observation:
    """The paper's."""
    return Observation({"rays": Rays()})


def rays_and_last_action() -> Observation:
    """For a driver that is to steer smoothly."""
    return Observation({"rays": Rays(), "last_action": LastAction()})
