"""Rewards for driving fast: the way along the centreline, the speed along it, time, contact that costs by speed.

Shapes: `N` cars.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from carrl.task.episode import StepContext
from carrl.task.reward import FiniteTerm


@dataclass(frozen=True)
class Progress(FiniteTerm):
    """For the way along the centreline, backwards counting against it.

    Source: Fuchs et al. 2021, "Super-Human Performance in Gran Turismo Sport Using Deep Reinforcement Learning", eq. 2.

    Attributes:
        weight: for each metre.
    """

    needs: ClassVar[tuple[str, ...]] = ("place",)
    weight: float = 1.0

    def __call__(self, step: StepContext) -> Tensor:
        """Of the projection on the centreline in this step."""
        return self.weight * step.outcome.progress


@dataclass(frozen=True)
class Contact(FiniteTerm):
    """For each step in which the car touches a wall, by the speed that it comes with.

    Source: Fuchs et al. 2021, eq. 3, without a fixed part.

    Attributes:
        fixed: whatever the speed.
        squared: times the square of the speed before the step, in m/s.
    """

    fixed: float = 0.0
    squared: float = -5e-4

    def __call__(self, step: StepContext) -> Tensor:
        """Where the body touched a wall."""
        worth: Tensor | float = self.fixed
        if self.squared:
            worth = self.fixed + self.squared * step.value_before("speed") ** 2
        return torch.where(step.outcome.collided, worth, 0.0)


@dataclass(frozen=True)
class SpeedAlong(FiniteTerm):
    """For the speed along the road, less what leads across it, and less for driving beside its middle.

    With the velocity v and its angle a against the centreline's direction, a step earns
    `along` v cos a + `across` |v sin a| + `beside` v |track position|.

    Source: Lillicrap et al. 2016, "Continuous control with deep reinforcement learning", appendix 9.1, has the first
    part alone; Lau 2016, "Using Keras and Deep Deterministic Policy Gradient to play TORCS", all three, with weights
    1, -1 and -1.

    Attributes:
        along: for each m/s along the road.
        across: for each m/s across it.
        beside: for each m/s at the edge of the road, in proportion to the way from its middle.
    """

    needs: ClassVar[tuple[str, ...]] = ("place",)
    along: float = 1.0
    across: float = 0.0
    beside: float = 0.0

    def __call__(self, step: StepContext) -> Tensor:
        """After the step."""
        speed, angle = step.value("speed"), step.outcome.heading_error + step.value("slip")
        earned = self.along * speed * angle.cos()
        if self.across:
            earned = earned + self.across * (speed * angle.sin()).abs()
        if self.beside:
            earned = earned + self.beside * speed * step.outcome.side.abs()
        return earned


@dataclass(frozen=True)
class Time(FiniteTerm):
    """For each second.

    Attributes:
        weight: what it earns.
    """

    weight: float = -1.0

    def __call__(self, step: StepContext) -> Tensor:
        """The same in every step."""
        return torch.full_like(step.outcome.ranges[:, 0], self.weight * step.simulator.vehicle.time_step)
