"""Greedy and epsilon-greedy policies, for many replicates at once.

Shapes: `A` replicates, `B` cars, of which each replicate drives the next B / A; `O` values of an observation; `K`
actions.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import EGreedyModule

from carrl.algorithms.algorithm import CollectPolicy
from carrl.algorithms.common.network import QNetwork
from carrl.algorithms.common.stacked import StackedLayers
from carrl.errors import ConfigError
from carrl.log.schema import Column
from carrl.task.random_streams import restore, states_of


class EpsilonGreedy(EGreedyModule):
    """Replaces an action by a random one with probability epsilon, which a subclass gives for every env step.

    TorchRL's own module anneals linearly; this one overrides the schedule, draws from generators of its own, and
    also writes `epsilon` [B] float32 and `exploratory` [B] bool, whether the action was drawn at random. All cars
    that step together act on the same t; `step` counts every car of one replicate.

    Args:
        epsilon_max: at t = 0.
        epsilon_min: which epsilon never falls below.
        action_spec: of one car.
        generators: one for each replicate, on the CPU; the cars are divided evenly among them, in order.

    Raises:
        ConfigError: unless 0 <= epsilon_min <= epsilon_max <= 1.
    """

    def __init__(
        self,
        epsilon_max: float,
        epsilon_min: float,
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
        super().__init__(spec=action_spec, eps_init=float(epsilon_max), eps_end=float(epsilon_min))
        self.epsilon_max, self.epsilon_min = epsilon_max, epsilon_min
        self._action_count = action_spec.n
        self._generators = list(generators)
        self.register_buffer("env_steps", torch.zeros((), dtype=torch.int64))

    @property
    def epsilon(self) -> float:
        """The probability of a random action in the next call."""
        return self.eps.item()

    def step(self, frames: int = 1) -> None:
        """Counts env steps, of however many cars, and moves epsilon along its schedule."""
        self.env_steps += frames
        self.eps.fill_(self.epsilon_min + (self.epsilon_max - self.epsilon_min) * self._left(self.env_steps.item()))

    def _left(self, t: int) -> float:
        """How much of the way from the greatest to the least epsilon is left after t env steps, 1 to 0."""
        raise NotImplementedError

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


class ExponentialEpsilonGreedy(EpsilonGreedy):
    """epsilon(t) = epsilon_min + (epsilon_max - epsilon_min) * exp(-decay_rate * t), t in env steps.

    Source: the paper, eq. 4 and Table I.

    Args:
        epsilon_max: at t = 0.
        epsilon_min: towards which epsilon decays.
        decay_rate: 1 / env steps.
        action_spec: of one car.
        generators: as `EpsilonGreedy` has them.

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
        if not 0 <= decay_rate < math.inf:
            raise ConfigError(f"exploration.decay_rate is {decay_rate}; it must be 0 or more per env step")
        super().__init__(epsilon_max, epsilon_min, action_spec=action_spec, generators=generators)
        self.decay_rate = decay_rate

    def _left(self, t: int) -> float:
        return math.exp(-self.decay_rate * t)


class LinearEpsilonGreedy(EpsilonGreedy):
    """Epsilon falls in a straight line from `epsilon_max` at t = 0 to `epsilon_min`, and stays there.

    Source: Mnih et al. 2015, "Human-level control through deep reinforcement learning", Methods.

    Args:
        epsilon_max: at t = 0.
        epsilon_min: from t = `env_steps_to_min` on.
        env_steps_to_min: how long it falls, env steps.
        action_spec: of one car.
        generators: as `EpsilonGreedy` has them.

    Raises:
        ConfigError: unless 0 <= epsilon_min <= epsilon_max <= 1 and it falls for at least one env step.
    """

    def __init__(
        self,
        epsilon_max: float,
        epsilon_min: float,
        env_steps_to_min: int,
        *,
        action_spec: TensorSpec,
        generators: Sequence[torch.Generator],
    ) -> None:
        if env_steps_to_min < 1:
            raise ConfigError(f"exploration.env_steps_to_min is {env_steps_to_min}; it must be at least 1")
        super().__init__(epsilon_max, epsilon_min, action_spec=action_spec, generators=generators)
        self.env_steps_to_min = env_steps_to_min

    def _left(self, t: int) -> float:
        return max(0.0, 1 - t / self.env_steps_to_min)


class ConstantEpsilonGreedy(EpsilonGreedy):
    """Epsilon stays what it is.

    Args:
        epsilon: probability of a random action; 0 never explores, as is usual with a noisy network.
        action_spec: of one car.
        generators: as `EpsilonGreedy` has them.

    Raises:
        ConfigError: epsilon lies outside 0..1.
    """

    def __init__(
        self,
        epsilon: float,
        *,
        action_spec: TensorSpec,
        generators: Sequence[torch.Generator],
    ) -> None:
        if not 0 <= epsilon <= 1:
            raise ConfigError(f"exploration.epsilon is {epsilon}; it must lie in 0..1")
        super().__init__(epsilon, epsilon, action_spec=action_spec, generators=generators)

    def _left(self, t: int) -> float:
        return 0.0


class GreedyPolicy(TensorDictModuleBase):
    """The actions of the highest value, each car's by its own replicate's network.

    Reads `observation` [B, O]; writes `action_value` [B, K], `chosen_action_value` [B, 1] and `action` [B], int64, as
    each network does. The networks' parameters become views of stacked ones, so that the policy follows whatever
    trains them.

    Args:
        networks: one for each replicate, all of one shape.
    """

    in_keys = ["observation"]  # noqa: RUF012 (TensorDict's protocol)
    out_keys = ["action_value", "chosen_action_value", "action"]  # noqa: RUF012

    def __init__(self, networks: Sequence[QNetwork]) -> None:
        super().__init__()
        self.layers = StackedLayers([network.layers for network in networks])

    def action_values(self, observation: Tensor) -> Tensor:
        """The value of every action, [B, K]: observations [B, O] as the environment gives them."""
        values: Tensor = self.layers(observation)
        return values

    def actions(self, observation: Tensor) -> Tensor:
        """The actions of the highest value, [B], int64: observations [B, O] as the environment gives them."""
        return self.action_values(observation).argmax(dim=-1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions and their values."""
        values = self.action_values(tensordict["observation"])
        action = values.argmax(dim=-1)
        tensordict["action_value"] = values
        tensordict["chosen_action_value"] = values.gather(-1, action[:, None])
        tensordict["action"] = action
        return tensordict


class GreedyActions:
    """The actions of the highest value, by one network, as a function of observations; a log is told the values."""

    def __init__(self, network: QNetwork) -> None:
        self._policy = GreedyPolicy([network])

    def __call__(self, observation: Tensor) -> Tensor:
        """The actions [B], int64: observations [B, O] as the environment gives them."""
        return self._policy.actions(observation)

    def log_columns(self, action_names: Sequence[str]) -> tuple[Column, ...]:
        """What `logged` has to say."""
        return (value_column(action_names),)

    def logged(self, observation: Tensor) -> dict[str, Tensor]:
        """The columns' values."""
        return {"action_value": self._policy.action_values(observation)}


def value_column(action_names: Sequence[str]) -> Column:
    """The value of every action."""
    names = tuple(action_names)
    return Column("action_value", "action_value", "float32", (len(names),), "Q-values of the actions", names)


class ExploringPolicy(CollectPolicy):
    """The greedy action, or by chance another one; writes what both its parts do."""

    in_keys = GreedyPolicy.in_keys
    out_keys = [*GreedyPolicy.out_keys, "epsilon", "exploratory"]  # noqa: RUF012

    def __init__(self, greedy: GreedyPolicy, exploration: EpsilonGreedy) -> None:
        super().__init__()
        self.greedy, self.exploration = greedy, exploration

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions."""
        return self.exploration(self.greedy(tensordict))

    @property
    def device(self) -> torch.device:
        """Where it acts."""
        return self.exploration.env_steps.device

    def shared_state(self) -> dict[str, Any]:
        """The networks' weights, and the env steps by which epsilon falls."""
        weights = {name: weight.cpu() for name, weight in self.greedy.layers.weights.items()}
        return {"weights": weights, "env_steps": int(self.exploration.env_steps)}

    def load_shared_state(self, state: Mapping[str, Any]) -> None:
        """Acts from now on as the policy with this state."""
        self.greedy.layers.load_weights(state["weights"])
        self.exploration.step(state["env_steps"] - int(self.exploration.env_steps))
