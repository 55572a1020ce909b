"""The reward, composed of terms: the paper's three, what steering costs, and shaping that leads to the next gate.

Shapes: `N` cars, `K` terms.

Source: "Simulation-based Self-driving Car using Reinforcement Learning", section IV.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.rows import scalar
from carrl.task.checks import number
from carrl.task.episode import StepContext

_MOST = sys.float_info.max
LAP_TERMS = ("collision", "proximity", "gate")
"""The paper's, which make up what a lap earns."""


class RewardTerm(Protocol):
    """A pure function of a step.

    A term that looks at where on the road the car is, which costs time, has an attribute `needs` with the name "place".
    """

    def __call__(self, step: StepContext) -> Tensor:
        """What the step earns, [N], float32."""


class FiniteTerm:
    """Refuses values that are no finite numbers."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a value that is no finite number."""
        for name, value in vars(self).items():
            number(f"reward: {name} of {type(self).__name__}", value, -_MOST, _MOST, "a finite number")


class _Weighted(FiniteTerm):
    """A term with one weight."""

    weight: float

    @cached_property
    def _weight(self) -> Tensor:
        return scalar(float(self.weight))


@dataclass(frozen=True)
class Collision(_Weighted):
    """For touching a wall.

    Attributes:
        weight: what that earns.
    """

    weight: float = -200.0

    def __call__(self, step: StepContext) -> Tensor:
        """The weight where the body touched a wall."""
        return step.outcome.collided * self._weight


@dataclass(frozen=True)
class Proximity(_Weighted):
    """For coming near a wall; not on top of a collision.

    Attributes:
        weight: what a step earns in which any sensor reads less than the threshold.
        threshold: as a share of the sensor's range, 0..1.
    """

    weight: float = -20.0
    threshold: float = 0.1

    @cached_property
    def _threshold(self) -> Tensor:
        return scalar(float(self.threshold))

    def is_near_wall(self, readings: Tensor) -> Tensor:
        """Whether any of the readings [..., R] in 0..1 lies below the threshold: [...], bool."""
        return readings.amin(dim=-1) < self._threshold

    def __call__(self, step: StepContext) -> Tensor:
        """The weight where the car is near a wall after the step."""
        nearest = step.simulator.sensor.readings(step.outcome.ranges.amin(dim=-1))  # one division a car, not a ray
        return ((nearest < self._threshold) > step.outcome.collided) * self._weight  # near, and has not collided


@dataclass(frozen=True)
class Gate(_Weighted):
    """For each gate passed.

    Attributes:
        weight: what one earns.
    """

    weight: float = 50.0

    def __call__(self, step: StepContext) -> Tensor:
        """The weight for each gate passed in the step."""
        return step.outcome.gates_passed * self._weight


@dataclass(frozen=True)
class Steering(FiniteTerm):
    """For turning the wheel; not the paper's.

    Attributes:
        turn: for a wheel turned fully, in proportion.
        switch: for each change between straight on and a full turn, in proportion; left to right is two of them.
    """

    turn: float = 0.0
    switch: float = 0.0

    def __call__(self, step: StepContext) -> Tensor:
        """In proportion to the control `steer` and to its change."""
        if not self.turn and not self.switch:
            return step.outcome.ranges.new_zeros(len(step.outcome.ranges))
        steer, last_steer = step.control("steer"), step.last_control("steer")
        return self.turn * steer.abs() + self.switch * (steer - last_steer).abs()


@dataclass(frozen=True)
class Shaping(FiniteTerm):
    """For coming closer to the next gate; not the paper's.

    The potential of a state is -approach * distance, that of the end of an episode 0, and a step earns discount *
    potential after it - potential before it. Whatever the potentials are, the best policy stays the best: all that they
    give is taken back, at the latest when the gate is passed and the next one is far away.

    Source: Ng, Harada and Russell 1999, "Policy Invariance Under Reward Transformations", theorem 1.

    Attributes:
        approach: for each metre by which the next gate comes closer.
        discount: of the values that are learnt; the potentials after a step count by it.
    """

    approach: float = 0.5
    discount: float = 1.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a weight or a discount out of its range."""
        super().__post_init__()
        if not self.approach >= 0:
            raise ConfigError(f"reward: approach of Shaping is {self.approach}; it must be 0 or more per metre")
        if not 0 <= self.discount <= 1:
            raise ConfigError(f"reward: discount of Shaping is {self.discount}; it must lie in 0..1")

    def __call__(self, step: StepContext) -> Tensor:
        """From the distance in a straight line to the middle of what is the next gate before and after the step."""
        before, after = map(step.simulator.gate_distance, (step.before.cars, step.outcome.cars))
        before = before.nan_to_num(0, 0, 0)  # of a car whose pose is not finite, which collides
        after = torch.where(step.outcome.collided, 0, after)
        return (self.approach * (before - self.discount * after)).float()


@dataclass(frozen=True)
class Reward:
    """What a step earns: the sum of its terms.

    Attributes:
        terms: by name, in their order; at least one.
    """

    terms: Mapping[str, RewardTerm]

    def __post_init__(self) -> None:
        """Raises ConfigError where there is nothing to earn."""
        if not self.terms:
            raise ConfigError("reward has no terms; name at least one, such as collision")

    @property
    def term_names(self) -> tuple[str, ...]:
        """What the terms are called, in their order."""
        return tuple(self.terms)

    def __call__(self, step: StepContext) -> Tensor:
        """The reward of a step split into its terms, [N, K], float32."""
        return torch.stack([term(step) for term in self.terms.values()], dim=-1).float()

    def total(self, terms: Tensor, names: tuple[str, ...]) -> Tensor:
        """The sum of the terms of these names, as far as there are such: [..., K] to [...]."""
        wanted = [index for index, name in enumerate(self.terms) if name in names]
        return terms[..., wanted].sum(dim=-1)

    @property
    def proximity(self) -> Proximity | None:
        """The term that says what is near a wall, if there is one."""
        return next((term for term in self.terms.values() if isinstance(term, Proximity)), None)

    @property
    def near_wall(self) -> Proximity:
        """The same; if there is none the paper's, but that it earns nothing."""
        return self.proximity or Proximity(weight=0.0)


def paper_reward(turn: float = 0.0, switch: float = 0.0) -> Reward:
    """The paper's, and if wanted something for steering."""
    terms: dict[str, RewardTerm] = {
        "collision": Collision(),
        "proximity": Proximity(),
        "gate": Gate(),
        "steering": Steering(turn, switch),
    }
    return Reward(terms)
