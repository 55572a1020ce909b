"""Epsilon-greedy exploration on the paper's schedule.

Shapes: `B` cars.
"""

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import EGreedyModule

from carrl.errors import ConfigError
from carrl.generators import restore, states_of


class ExponentialEpsilonGreedy(EGreedyModule):
    """Replaces an action by a random one with probability epsilon, which decays exponentially with the env steps.

    epsilon(t) = epsilon_min + (epsilon_max - epsilon_min) * exp(-decay_rate * t), t in env steps.

    TorchRL's own module anneals linearly; this one overrides the schedule, draws from generators of its own, and
    also writes `epsilon` [B] float32 and `exploratory` [B] bool, whether the action was drawn at random. All cars
    that step together act on the same t; `step` counts every car of one agent.

    Source: the paper, eq. 4 and Table I.

    Args:
        epsilon_max: at t = 0.
        epsilon_min: towards which epsilon decays.
        decay_rate: 1 / env steps.
        action_spec: of one car.
        generators: one for each agent, on the CPU; the cars are divided evenly among them, in order.

    Raises:
        ConfigError: unless 0 <= epsilon_min <= epsilon_max <= 1 and decay_rate >= 0.
    """

    def __init__(
        self,
        epsilon_max: float,
        epsilon_min: float,
        decay_rate: float,
        *,
        action_spec: TensorSpec,
        generators: Sequence[torch.Generator],
    ) -> None:
        """Starts at t = 0."""
        if not 0 <= epsilon_min <= epsilon_max <= 1:
            raise ConfigError(
                f"exploration.epsilon_min is {epsilon_min} and epsilon_max is {epsilon_max}; "
                "they must satisfy 0 <= epsilon_min <= epsilon_max <= 1"
            )
        if not 0 <= decay_rate < math.inf:
            raise ConfigError(f"exploration.decay_rate is {decay_rate}; it must be 0 or more per env step")
        super().__init__(spec=action_spec, eps_init=epsilon_max, eps_end=epsilon_min)
        self.epsilon_max, self.epsilon_min, self.decay_rate = epsilon_max, epsilon_min, decay_rate
        self._action_count = action_spec.n
        self._generators = list(generators)
        self.register_buffer("env_steps", torch.zeros((), dtype=torch.int64))

    @property
    def epsilon(self) -> float:
        """The probability of a random action in the next call."""
        return self.eps.item()

    def step(self, frames: int = 1) -> None:
        """Counts env steps, of however many cars, and moves epsilon along eq. 4."""
        self.env_steps += frames
        decay = math.exp(-self.decay_rate * self.env_steps.item())
        self.eps.fill_(self.epsilon_min + (self.epsilon_max - self.epsilon_min) * decay)

    def get_extra_state(self) -> list[Tensor]:
        """Where the generators stand: part of `state_dict`, beside epsilon and the env steps."""
        return states_of(self._generators)

    def set_extra_state(self, state: list[Tensor]) -> None:
        """Goes on from where the generators stood; called by `load_state_dict`."""
        restore(self._generators, state)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Explores unless the exploration type asks for the greedy action."""
        greedy = tensordict["action"]
        epsilon = self.eps.expand(greedy.shape)
        if exploration_type() not in (ExplorationType.RANDOM, None):
            epsilon = torch.zeros_like(epsilon)
        share = len(greedy) // len(self._generators)
        chance = torch.cat([torch.rand(share, generator=each) for each in self._generators]).to(greedy.device)
        drawn = torch.cat([torch.randint(self._action_count, (share,), generator=each) for each in self._generators])
        exploratory = chance < epsilon
        tensordict["action"] = torch.where(exploratory, drawn.to(greedy.device), greedy)
        tensordict["epsilon"] = epsilon.clone()
        tensordict["exploratory"] = exploratory
        return tensordict
