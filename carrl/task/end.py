"""When an episode ends before its time is up: at a wall, where the car gets no further, where it runs backwards.

Shapes: `N` cars.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from carrl.config import is_whole_number
from carrl.errors import ConfigError, shown
from carrl.task.checks import number
from carrl.task.episode import StepContext


class EndTerm(Protocol):
    """A pure function of a step."""

    def __call__(self, step: StepContext) -> Tensor:
        """Whether it terminates the episode, [N], bool."""


@dataclass(frozen=True)
class EndAtContact:
    """Touching a wall ends the episode, as in the paper."""

    def __call__(self, step: StepContext) -> Tensor:
        """Where the body touched a wall."""
        return step.outcome.collided


@dataclass(frozen=True)
class SlideAlongWall:
    """Touching a wall ends nothing: the car goes on along it, and only the part of its speed that leads there remains.

    Attributes:
        kept: share of that part that remains after each step of contact, 0..1.
    """

    kept: float = 0.9

    def __post_init__(self) -> None:
        """Raises ConfigError for a share out of its range."""
        number("end: kept of SlideAlongWall", self.kept, 0, 1, "a share between 0 and 1")

    def __call__(self, step: StepContext) -> Tensor:
        """Nowhere."""
        return torch.zeros_like(step.outcome.collided)


@dataclass(frozen=True)
class EndAtCarContact:
    """Touching another car ends the episodes of both."""

    def __call__(self, step: StepContext) -> Tensor:
        """Where the car touched another one."""
        contact = step.outcome.contact
        return torch.zeros_like(step.outcome.collided) if contact is None else contact.touched


@dataclass(frozen=True)
class BumpIntoCars:
    """Touching another car ends nothing: the two push each other, and lose speed.

    Attributes:
        kept: share of its speed after the push that a car keeps, 0..1.
    """

    kept: float = 0.9

    def __post_init__(self) -> None:
        """Raises ConfigError for a share out of its range."""
        number("end: kept of BumpIntoCars", self.kept, 0, 1, "a share between 0 and 1")

    def __call__(self, step: StepContext) -> Tensor:
        """Nowhere."""
        return torch.zeros_like(step.outcome.collided)


@dataclass(frozen=True)
class NoProgress:
    """A car that gets no further ends its episode.

    Attributes:
        steps: how many in a row.
        speed: along the centreline that counts as getting further, m/s.
    """

    needs: ClassVar[tuple[str, ...]] = ("place", "stalled")
    steps: int = 100
    speed: float = 1.4

    def __post_init__(self) -> None:
        """Raises ConfigError for a value out of its range."""
        if not (is_whole_number(self.steps) and self.steps >= 1):
            raise ConfigError(f"end: steps of NoProgress is {self.steps}; it must be a whole number of at least 1")
        number("end: speed of NoProgress", self.speed, 0, 1000, "between 0 and 1000 m/s")

    def count(self, step: StepContext) -> Tensor:
        """For how many steps the cars have made no progress after this one, [N], int64."""
        if step.before.stalled is None:
            raise ConfigError('an end counts steps without progress; its class must say `needs = ("place", "stalled")`')
        is_stalled = step.outcome.progress < self.speed * step.simulator.vehicle.time_step
        return torch.where(is_stalled, step.before.stalled + 1, 0)

    def __call__(self, step: StepContext) -> Tensor:
        """Where the steps are full."""
        return self.count(step) >= self.steps


@dataclass(frozen=True)
class RunningBackwards:
    """A car that has turned round ends its episode.

    Attributes:
        angle: of its heading against the centreline's direction beyond which it has, degrees.
    """

    needs: ClassVar[tuple[str, ...]] = ("place",)
    angle: float = 90.0

    def __post_init__(self) -> None:
        """Raises ConfigError for an angle out of its range."""
        number("end: angle of RunningBackwards", self.angle, 0, 180, "between 0 and 180 degrees")

    def __call__(self, step: StepContext) -> Tensor:
        """Where the heading is further off than the angle."""
        return step.outcome.heading_error.abs() > math.radians(self.angle)


@dataclass(frozen=True)
class End:
    """What ends an episode; any of the terms does.

    Attributes:
        terms: by name, one of them an `EndAtContact` or a `SlideAlongWall`. Unless there is an `EndAtCarContact` or a
            `BumpIntoCars`, touching another car ends an episode where touching a wall does.
    """

    terms: Mapping[str, EndTerm]

    def __post_init__(self) -> None:
        """Raises ConfigError unless it is clear what happens to a car that touches a wall."""
        rules = [name for name, term in self.terms.items() if isinstance(term, EndAtContact | SlideAlongWall)]
        if len(rules) != 1:
            found = f"both {' and '.join(rules)}" if rules else f"{shown(list(self.terms))}"
            raise ConfigError(
                f"end has {found}; it must have exactly one term that says what touching a wall does, EndAtContact or "
                "SlideAlongWall"
            )
        if sum(isinstance(term, NoProgress) for term in self.terms.values()) > 1:
            raise ConfigError("end has more than one NoProgress; leave one")
        if sum(isinstance(term, EndAtCarContact | BumpIntoCars) for term in self.terms.values()) > 1:
            raise ConfigError("end has more than one term that says what touching a car does; leave one")

    @property
    def slide(self) -> float | None:
        """Share of its speed along a wall that a car keeps in a step of contact; None where that ends its episode."""
        return next((term.kept for term in self.terms.values() if isinstance(term, SlideAlongWall)), None)

    @property
    def bump(self) -> float | None:
        """Share of its speed that a car keeps which touches another one; None where that ends its episode."""
        return next((term.kept for term in self.terms.values() if isinstance(term, BumpIntoCars)), self._bump)

    @property
    def _bump(self) -> float | None:
        """The same as walls have it."""
        return None if any(isinstance(term, EndAtCarContact) for term in self.terms.values()) else self.slide

    @property
    def has_others(self) -> bool:
        """Whether something else than a wall may end an episode."""
        return len(self.terms) > 1

    def stalled(self, step: StepContext) -> Tensor | None:
        """For how many steps the cars have made no progress, [N], int64; None where that does not matter."""
        return next((term.count(step) for term in self.terms.values() if isinstance(term, NoProgress)), None)

    def __call__(self, step: StepContext) -> Tensor:
        """Whether the step terminates the episodes, [N], bool."""
        first, *others = (term(step) for term in self.terms.values())
        for ends in others:
            first = first | ends
        contact = step.outcome.contact
        return first if contact is None or self.bump is not None else first | contact.touched


def end_at_contact() -> End:
    """The paper's."""
    return End({"contact": EndAtContact()})
