"""How the learning rate falls while a run goes on.

A schedule knows nothing but the number of updates, so that a resumed run goes on with it where it was.
"""

import math
from dataclasses import dataclass

from carrl.errors import ConfigError


@dataclass(frozen=True)
class LearningRateDecay:
    """What linear and cosine decay have in common.

    Attributes:
        final_share: of `optimizer.lr` that is left at the end, and from then on.
        updates: after which the end is reached.
    """

    final_share: float
    updates: int

    def __post_init__(self) -> None:
        """Raises ConfigError unless the share lies in 0..1 and there is an update."""
        if not 0 <= self.final_share <= 1:
            raise ConfigError(f"learning_rate.final_share is {self.final_share}; it must lie in 0..1")
        if self.updates < 1:
            raise ConfigError(f"learning_rate.updates is {self.updates}; it must be at least 1")

    def share(self, update: int) -> float:
        """The share of the learning rate that an update is made with; the first one is number 0."""
        return self.final_share + (1 - self.final_share) * self._left(min(1.0, update / self.updates))

    def _left(self, elapsed: float) -> float:
        """How much of the way down is left, 1 to 0, when this share of the time has elapsed."""
        raise NotImplementedError


@dataclass(frozen=True)
class LinearDecay(LearningRateDecay):
    """Falls by the same amount with each update.

    Attributes:
        final_share: of optimizer.lr that is left at the end.
        updates: after which the end is reached; by default there is one for each env step.
    """

    def _left(self, elapsed: float) -> float:
        return 1 - elapsed


@dataclass(frozen=True)
class CosineDecay(LearningRateDecay):
    """Falls along half a wave: slowly, quickly, slowly.

    Source: Loshchilov and Hutter 2017, "SGDR: Stochastic Gradient Descent with Warm Restarts", eq. 5, without restarts.

    Attributes:
        final_share: of optimizer.lr that is left at the end.
        updates: after which the end is reached; by default there is one for each env step.
    """

    def _left(self, elapsed: float) -> float:
        return (1 + math.cos(math.pi * elapsed)) / 2
