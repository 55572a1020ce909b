"""How a car is driven while its agent learns."""

from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictSequential
from torch import Tensor

from carrl.algorithms.common.policy import GreedyPolicy
from carrl.algorithms.dqn.exploration import EpsilonGreedy


@dataclass(frozen=True)
class Knowledge:
    """All that moves in a policy but its random generators.

    Attributes:
        weights: see `GreedyPolicy.weights`, on the CPU.
        env_steps: of each agent, by which epsilon decays.
    """

    weights: dict[str, Tensor]
    env_steps: int


class ExploringPolicy(TensorDictSequential):
    """The greedy action, or by chance another one.

    A copy of it in another process, made by the same configuration, acts alike once it has followed `knowledge`.
    """

    def __init__(self, greedy: GreedyPolicy, exploration: EpsilonGreedy) -> None:
        super().__init__(greedy, exploration)
        self._greedy, self._exploration = [greedy], [exploration]  # in lists, so that torch finds them but once

    @property
    def device(self) -> torch.device:
        """Where it acts."""
        return self._exploration[0].env_steps.device

    @property
    def knowledge(self) -> Knowledge:
        """What a copy must be told."""
        weights = {name: weight.cpu() for name, weight in self._greedy[0].weights.items()}
        return Knowledge(weights, int(self._exploration[0].env_steps))

    def follow(self, knowledge: Knowledge) -> None:
        """Acts from now on as the policy whose knowledge this is; only the random numbers stay its own."""
        self._greedy[0].load_weights(knowledge.weights)
        exploration = self._exploration[0]
        exploration.step(knowledge.env_steps - int(exploration.env_steps))
