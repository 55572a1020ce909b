"""Noise on actions, which explores.

TorchRL 0.14 has modules for both kinds, too. They draw from torch's own generator, which replicates would share, count
every env step by an operation on a float32 number, which beyond some ten million steps no longer moves, and need 1,000
env steps by default before an Ornstein-Uhlenbeck process has its spread.

Shapes: `A` replicates, `B` cars, of which each replicate drives the next B / A; `C` controls.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.data import TensorSpec

from carrl.errors import ConfigError
from carrl.task.random_streams import restore, states_of

OfControls = float | Sequence[float]
"""One number for all controls, or one for each."""
MOST = 10.0
"""Noise beyond this is none but full left or full right."""


class ActionNoise(nn.Module):
    """Adds something to actions, within their bounds.

    Args:
        action_spec: of one car.
        generators: one for each replicate, on the CPU; the cars are divided evenly among them, in order.
    """

    env_steps: Tensor

    def __init__(self, action_spec: TensorSpec, generators: Sequence[torch.Generator]) -> None:
        """Starts at env step 0."""
        super().__init__()
        self._generators = list(generators)
        self._controls = int(action_spec.shape[-1])
        self.register_buffer("env_steps", torch.zeros((), dtype=torch.int64))

    @property
    def device(self) -> torch.device:
        """Where it acts."""
        return self.env_steps.device

    def step(self, frames: int) -> None:
        """Counts env steps, of however many cars of one replicate."""
        self.env_steps += frames

    def figures(self) -> Mapping[str, float]:
        """How much noise there is now."""
        return {}

    @abstractmethod
    def forward(self, action: Tensor, is_first: Tensor) -> Tensor:
        """The actions [B, C] with noise; of the cars [B] bool at the first step of an episode."""

    def draw(self, cars: int) -> Tensor:
        """Standard normal numbers, [B, C], each replicate's from its own generator."""
        share = cars // len(self._generators)
        drawn = [torch.randn(share, self._controls, generator=each) for each in self._generators]
        return torch.cat(drawn).to(self.device)

    def get_extra_state(self) -> dict[str, Any]:
        """Where the generators stand: part of `state_dict`, beside the env steps."""
        return {"generators": states_of(self._generators)}

    def set_extra_state(self, state: Mapping[str, Any]) -> None:
        """Goes on from there; called by `load_state_dict`."""
        restore(self._generators, state["generators"])


class NoNoise(ActionNoise):
    """Leaves actions as they are: a stochastic actor explores by itself.

    Args:
        action_spec: of one car.
        generators: one for each replicate.
    """

    def __init__(self, *, action_spec: TensorSpec, generators: Sequence[torch.Generator]) -> None:
        super().__init__(action_spec, generators)

    def forward(self, action: Tensor, is_first: Tensor) -> Tensor:
        """The actions themselves."""
        return action


class ScheduledNoise(ActionNoise):
    """Noise whose strength falls in a straight line with the env steps, and then stays.

    Args:
        sigma: how strong it is at first: a standard deviation, one for all controls or one for each.
        final_share: of that which is left at the end.
        env_steps_to_final: how long it falls, env steps.
        action_spec: of one car.
        generators: one for each replicate.

    Raises:
        ConfigError: a negative sigma or as many as there are not controls, a share outside 0..1, or no env steps.
    """

    sigma: Tensor

    def __init__(
        self,
        sigma: OfControls,
        final_share: float,
        env_steps_to_final: int,
        *,
        action_spec: TensorSpec,
        generators: Sequence[torch.Generator],
    ) -> None:
        super().__init__(action_spec, generators)
        if not 0 <= final_share <= 1:
            raise ConfigError(f"exploration.final_share is {final_share}; it must lie in 0..1")
        if env_steps_to_final < 1:
            raise ConfigError(f"exploration.env_steps_to_final is {env_steps_to_final}; it must be at least 1")
        self._final_share, self._env_steps_to_final = final_share, env_steps_to_final
        self.register_buffer("sigma", self._of_controls("sigma", sigma, 0.0, MOST), persistent=False)

    @property
    def share(self) -> float:
        """Of the strength at first, that of now."""
        left = max(0.0, 1 - int(self.env_steps) / self._env_steps_to_final)
        return self._final_share + (1 - self._final_share) * left

    def figures(self) -> Mapping[str, float]:
        """Its standard deviation, the mean of all controls'."""
        return {"sigma": self.share * self.sigma.mean().item()}

    def _of_controls(self, name: str, given: OfControls, least: float, most: float) -> Tensor:
        """A number for each control, [C]."""
        numbers = list(given) if isinstance(given, Sequence) else [given] * self._controls
        if len(numbers) != self._controls or not all(least <= number <= most for number in numbers):
            raise ConfigError(
                f"exploration.{name} is {given}; it must be a number from {least:g} to {most:g}, or a list of one for "
                f"each of the {self._controls} controls"
            )
        return torch.tensor(numbers, dtype=torch.float32)


class GaussianNoise(ScheduledNoise):
    """Normal noise, another one in each step.

    Source: Fujimoto et al. 2018, "Addressing Function Approximation Error in Actor-Critic Methods", section 5.2.

    Args:
        sigma: its standard deviation at first, one for all controls or, in a list, one for each.
        final_share: of it that is left at the end.
        env_steps_to_final: how long it falls in a straight line, env steps.
        action_spec: of one car.
        generators: one for each replicate.

    Raises:
        ConfigError: as `ScheduledNoise`.
    """

    def forward(self, action: Tensor, is_first: Tensor) -> Tensor:
        """The actions [B, C] with noise, cut off at -1 and 1."""
        return (action + self.share * self.sigma * self.draw(len(action))).clamp(-1, 1)


class OrnsteinUhlenbeckNoise(ScheduledNoise):
    """Noise that wanders: in each step it moves back towards a mean by a share of its distance, and by a normal number.

    It starts at the mean with each episode. After some 1 / theta steps its standard deviation is about
    sigma / sqrt(2 theta - theta^2).

    Source: Lillicrap et al. 2016, "Continuous control with deep reinforcement learning", section 7.

    Args:
        theta: share of the distance that it moves back in a step, one for all controls or one for each.
        sigma: standard deviation of what is added in a step at first, likewise.
        mean: towards which it moves, likewise.
        final_share: of all noise, the mean's share included, that is left at the end.
        env_steps_to_final: how long it falls, env steps.
        action_spec: of one car.
        generators: one for each replicate.

    Raises:
        ConfigError: as `ScheduledNoise`, or theta lies outside 0..1.
    """

    theta: Tensor
    mean: Tensor

    def __init__(
        self,
        theta: OfControls,
        sigma: OfControls,
        mean: OfControls,
        final_share: float,
        env_steps_to_final: int,
        *,
        action_spec: TensorSpec,
        generators: Sequence[torch.Generator],
    ) -> None:
        super().__init__(sigma, final_share, env_steps_to_final, action_spec=action_spec, generators=generators)
        self.register_buffer("theta", self._of_controls("theta", theta, 0.0, 1.0), persistent=False)
        self.register_buffer("mean", self._of_controls("mean", mean, -MOST, MOST), persistent=False)
        self._noise: Tensor | None = None

    def forward(self, action: Tensor, is_first: Tensor) -> Tensor:
        """The actions [B, C] with noise, cut off at -1 and 1."""
        before = self.mean.expand_as(action)
        if self._noise is not None:
            before = torch.where(is_first[:, None], before, self._noise)
        self._noise = before + self.theta * (self.mean - before) + self.sigma * self.draw(len(action))
        return (action + self.share * self._noise).clamp(-1, 1)

    def get_extra_state(self) -> dict[str, Any]:
        """The noise of every car, too."""
        return {**super().get_extra_state(), "noise": self._noise}

    def set_extra_state(self, state: Mapping[str, Any]) -> None:
        """Goes on with it.

        Raises:
            ValueError: it is that of other cars.
        """
        super().set_extra_state(state)
        noise = state["noise"]
        if noise is not None and (not isinstance(noise, Tensor) or noise.shape[1:] != self.mean.shape):
            raise ValueError("the noise of the actions is that of other cars")
        self._noise = None if noise is None else noise.to(self.device)
