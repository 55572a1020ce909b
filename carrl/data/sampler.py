"""Which transitions of the replay memory an update learns from.

Shapes: `A` agents, each with a memory of its own.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torchrl.data import RandomSampler, Storage

from carrl.generators import restore, states_of

_LEAST_ERROR = 1e-6
"""What is added to a TD error, so that no transition is never sampled."""


class Minibatch(NamedTuple):
    """Places in the memories: `storage[items, agents]` is the sample.

    Attributes:
        items: [batch_size, A], int64.
        agents: [batch_size, A], int64.
        weights: by which the losses count, [batch_size, A]; None where they count alike.
    """

    items: Tensor
    agents: Tensor
    weights: Tensor | None = None


class AgentSampler(RandomSampler):
    """Uniform with replacement, for every agent from its own memory and with its own generator.

    Args:
        generators: one for each agent.
    """

    is_weighted = False
    """Whether minibatches have weights, and TD errors are to be noted."""

    def __init__(self, generators: Sequence[torch.Generator]) -> None:
        self._generators = list(generators)
        self._agents = torch.arange(len(self._generators))

    @property
    def agents(self) -> int:
        """How many agents' memories there are."""
        return len(self._generators)

    def sample(self, storage: Storage, batch_size: int) -> tuple[tuple[Tensor, Tensor], dict[str, Any]]:
        """Indices of items and of agents, [batch_size, A] each, such that storage[items, agents] is the sample."""
        drawn = [torch.randint(len(storage), (batch_size,), generator=each) for each in self._generators]
        items = torch.stack(drawn, dim=1).to(storage.device)
        return (items, self._agents.to(storage.device).expand_as(items)), {}

    def minibatches(self, storage: Storage, count: int, batch_size: int) -> Iterator[Minibatch]:
        """Those of the next `count` updates."""
        samples, _ = self.sample(storage, count * batch_size)
        yield from map(Minibatch, *(index.split(batch_size) for index in samples))

    def state_dict(self) -> dict[str, Any]:
        """Where every generator stands."""
        return {"generators": states_of(self._generators)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from where the generators stood."""
        restore(self._generators, state_dict["generators"])


class PrioritizedAgentSampler(AgentSampler):
    """For every agent in proportion to |TD error|^alpha, with replacement.

    A transition that was never learnt from has the greatest priority so far. Weights make up for the sampling, by the
    exponent beta, with 1 in full; only their ratios count.

    TorchRL 0.14.1's `PrioritizedSampler` needs its C++ extension, which is built for another torch than 2.13 and does
    not load. A running sum over the memory takes 0.2 ms at 131,072 transitions, less than one eager update.

    Source: Schaul et al. 2016, "Prioritized Experience Replay", sections 3.3 and 3.4.

    Args:
        generators: one for each agent.
        capacity: of each agent's memory, transitions.
        alpha: exponent of the priorities; with 0 all transitions are alike.
        beta: exponent of the weights.
    """

    is_weighted = True

    def __init__(self, generators: Sequence[torch.Generator], capacity: int, alpha: float, beta: float) -> None:
        super().__init__(generators)
        self._alpha, self._beta = alpha, beta
        self._priorities = torch.zeros(self.agents, capacity, dtype=torch.float64)
        self._greatest = torch.ones(self.agents, dtype=torch.float64)

    def sample(self, storage: Storage, batch_size: int) -> tuple[tuple[Tensor, Tensor], dict[str, Any]]:
        """As `AgentSampler` does, and the weights under `priority_weight`, [batch_size, A]."""
        drawn = [torch.rand(batch_size, dtype=torch.float64, generator=each) for each in self._generators]
        sums = self._priorities[:, : len(storage)].cumsum(-1)
        items = torch.searchsorted(sums, torch.stack(drawn) * sums[:, -1:], right=True).clamp(max=len(storage) - 1)
        chosen = self._priorities.gather(-1, items)
        weights = (chosen / chosen.amin(-1, keepdim=True)) ** -self._beta
        items = items.T.contiguous().to(storage.device)
        return (items, self._agents.to(storage.device).expand_as(items)), {
            "priority_weight": weights.T.contiguous().float().to(storage.device)
        }

    def minibatches(self, storage: Storage, count: int, batch_size: int) -> Iterator[Minibatch]:
        """Those of the next updates, each drawn when the one before has set its priorities."""
        for _ in range(count):
            (items, agents), info = self.sample(storage, batch_size)
            yield Minibatch(items, agents, info["priority_weight"])

    def extend(self, index: Tensor) -> None:
        """Gives new transitions the greatest priority so far; called by the buffer."""
        self._priorities[:, index] = self._greatest[:, None]

    def set_priorities(self, items: Tensor, td_errors: Tensor) -> None:
        """Notes how large the TD errors of transitions were: both [batch_size, A]."""
        priorities = ((td_errors.abs().double().cpu() + _LEAST_ERROR) ** self._alpha).T
        self._priorities.scatter_(-1, items.cpu().T, priorities)
        self._greatest = self._greatest.maximum(priorities.amax(-1))

    def state_dict(self) -> dict[str, Any]:
        """Where every generator stands, and the priorities of what is in the memory."""
        filled = int(self._priorities[0].count_nonzero())
        return super().state_dict() | {"priorities": self._priorities[:, :filled], "greatest": self._greatest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from there; call it when the memory is as it was."""
        super().load_state_dict(state_dict)
        priorities = state_dict["priorities"]
        self._priorities.zero_()
        self._priorities[:, : priorities.shape[1]] = priorities
        self._greatest = state_dict["greatest"].clone()
