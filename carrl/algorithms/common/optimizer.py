"""What moves parameters: clipped gradients, falling learning rates, Adam as a function, and target networks.

Shapes: a gradient is a list of tensors, one for each parameter of one replicate's network.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torchrl.objectives import DQNLoss, HardUpdate, LossModule, SoftUpdate

from carrl.algorithms.algorithm import Tree
from carrl.algorithms.common.native import CompilationError
from carrl.errors import ConfigError

_EPSILON = 1e-6
"""What `torch.nn.utils.clip_grad_norm_` adds to a norm before it divides by it."""


def make_gradient_clipping(max_norm: float | None) -> "GradientClipping | None":
    """What scales a gradient that is too large down, each replicate's for itself; None for no limit, as in the paper.

    Args:
        max_norm: of the gradient over all parameters, such as 10, which most exceed in an ordinary run with the squared
            TD error; None for no limit.

    Raises:
        ConfigError: the limit is not positive.
    """
    return None if max_norm is None else GradientClipping(max_norm)


@dataclass(frozen=True)
class GradientClipping:
    """Scales a gradient down where its norm over all parameters exceeds a limit.

    Source: Pascanu et al. 2013, "On the difficulty of training recurrent neural networks", Algorithm 1.

    Attributes:
        max_norm: the limit.
    """

    max_norm: float

    def __post_init__(self) -> None:
        """Raises ConfigError unless the limit is a positive number."""
        if not 0 < self.max_norm < math.inf:
            raise ConfigError(f"gradient_clipping.max_norm is {self.max_norm}; it must be a positive number")

    def clipped(self, gradient: Sequence[Tensor]) -> list[Tensor]:
        """What `torch.nn.utils.clip_grad_norm_` makes of it, as new tensors, so that it can be traced."""
        norm = torch.stack([torch.linalg.vector_norm(each) for each in gradient]).norm()
        share = (self.max_norm / (norm + _EPSILON)).clamp(max=1)
        return [each * share for each in gradient]


@dataclass(frozen=True)
class LearningRateDecay:
    """How the learning rate falls while a run goes on: what linear and cosine decay have in common.

    It knows nothing but the number of updates, so that a resumed run goes on with it where it was.

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


class Adam(NamedTuple):
    """What a functional update needs of torch's Adam, the same for all replicates.

    Source: Kingma and Ba 2015, "Adam: A Method for Stochastic Optimization", Algorithm 1.
    """

    lr: float
    beta_1: float
    beta_2: float
    eps: float

    @classmethod
    def of(cls, optimizer: torch.optim.Optimizer) -> "Adam":
        """What an optimizer does.

        Raises:
            CompilationError: it is not plain Adam with one group of parameters.
        """
        if type(optimizer) is not torch.optim.Adam or len(optimizer.param_groups) != 1:
            raise CompilationError(f"the optimizer is {type(optimizer).__name__}, not Adam with one group")
        (group,) = optimizer.param_groups
        extras = [name for name in ("weight_decay", "amsgrad", "maximize", "decoupled_weight_decay") if group[name]]
        if extras:
            raise CompilationError(f"the optimizer uses {', '.join(extras)}")
        beta_1, beta_2 = group["betas"]
        return cls(group["lr"], beta_1, beta_2, group["eps"])

    @staticmethod
    def state_of(optimizer: torch.optim.Optimizer, parameters: Mapping[Any, Tensor]) -> Tree:
        """Its state, by `step`, `exp_avg` and `exp_avg_sq`, and by the parameters' names; it has made a step."""
        names = ("step", "exp_avg", "exp_avg_sq")
        return {name: {key: optimizer.state[each][name] for key, each in parameters.items()} for name in names}

    def step(self, parameters: Tree, gradients: Tree, state: Tree, lr: float | Tensor | None = None) -> tuple[Any, Any]:
        """One replicate's parameters and the optimizer's state after a step."""
        rate = self.lr if lr is None else lr
        moved: dict[Any, Tensor] = {}
        after: dict[str, dict[Any, Tensor]] = {name: {} for name in state}
        # All parameters have made as many steps, and a power of 0 dimensions would be taken anew for each of their
        # elements: Inductor (torch 2.13) writes what is taken of 16 numbers into memory first.
        taken = (next(iter(state["step"].values())) + 1).double().expand(16)
        left_1, left_2 = ((1 - beta**taken).amax() for beta in (self.beta_1, self.beta_2))
        for key, value in parameters.items():
            gradient, step = gradients[key], state["step"][key] + 1
            average = state["exp_avg"][key].lerp(gradient, 1 - self.beta_1)
            square = torch.addcmul(state["exp_avg_sq"][key] * self.beta_2, gradient, gradient, value=1 - self.beta_2)
            unbiased = average / left_1.to(average.dtype)
            scale = (square / left_2.to(square.dtype)).sqrt() + self.eps
            moved[key] = value - rate * unbiased / scale
            after["step"][key], after["exp_avg"][key], after["exp_avg_sq"][key] = step, average, square
        return moved, after


class PeriodicHardUpdate(HardUpdate):
    """Copies the network into the target network at env steps C, 2C, 3C and so on.

    TorchRL 0.14's `HardUpdate(value_network_update_interval=n)` copies at every n+1-th call of `step`, hence the minus
    one; `test_target_network_changes_exactly_at_steps_c_2c_3c` pins it.

    Source: the paper, Algorithm 1 and Table I (C).
    """

    def __init__(self, loss: LossModule, period: int) -> None:
        super().__init__(loss, value_network_update_interval=period - 1)

    @property
    def steps_left(self) -> int:
        """Env steps from now to the next copy, 1 or more."""
        return self.value_network_update_interval + 1 - self.counter

    def step(self, count: int = 1) -> None:
        """Counts env steps, at most as many as are left, and copies if none is left then."""
        self.counter += count - 1
        super().step()

    def follow(self) -> None:
        """Nothing after a single update: the copies keep to env steps."""

    def state_dict(self) -> dict[str, int]:
        """How far the next copy is."""
        return {"counter": self.counter}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Goes on counting from there.

        Raises:
            ValueError: no counter of this period can stand there.
        """
        if not 0 <= state["counter"] <= self.value_network_update_interval:
            raise ValueError(f"the counter is {state['counter']}")
        self.counter = state["counter"]


class SoftTargetUpdate(SoftUpdate):
    """Moves the target network a share of its way to the network after every update.

    Source: Lillicrap et al. 2016, "Continuous control with deep reinforcement learning", section 3 (tau).
    """

    steps_left = sys.maxsize
    """Env steps to the next copy: there is none."""

    def __init__(self, loss: LossModule, tau: float) -> None:
        super().__init__(loss, tau=tau)

    def step(self, count: int = 1) -> None:
        """Nothing at env steps: the target follows the updates."""

    def follow(self) -> None:
        """Moves the target network, after each update."""
        super().step()

    def state_dict(self) -> dict[str, int]:
        """Nothing but the loss's own parameters moves."""
        return {}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Nothing to put back."""


TargetUpdater = PeriodicHardUpdate | SoftTargetUpdate


def make_hard_update(period: int, *, loss: DQNLoss) -> PeriodicHardUpdate:
    """A hard update of the loss's target network every `period` env steps.

    Args:
        period: env steps between two copies (Table I, C); learning from logs, where there are none, each update counts
            as one.
        loss: whose target network follows.

    Raises:
        ConfigError: the period is less than 1.
    """
    if period < 1:
        raise ConfigError(f"target_updater.period is {period}; it must be at least 1 env step")
    return PeriodicHardUpdate(loss, period)


def make_soft_update(tau: float, *, loss: DQNLoss) -> SoftTargetUpdate:
    """A soft update of the loss's target network after every update: target += tau * (network - target).

    Args:
        tau: share of the way that the target network moves, at most 0.5; it is about 1 / tau updates behind.
        loss: whose target network follows.

    Raises:
        ConfigError: tau is no share of at most a half.
    """
    if not 0 < tau <= 0.5:
        raise ConfigError(
            f"target_updater.tau is {tau}; it must be more than 0 and at most 0.5, "
            "and to follow faster there is target_updater=hard"
        )
    return SoftTargetUpdate(loss, tau)
