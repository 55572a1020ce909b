"""The replay memory.

Shapes: `A` agents, which fill their memories side by side.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.data import LazyTensorStorage, RandomSampler, Storage, TensorDictReplayBuffer

from carrl.errors import ConfigError

KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""What the loss reads of a transition; nothing else is kept."""
MOST_TRANSITIONS = 2**27
"""Of a memory: about 10 GB with the default sensor."""


class AgentSampler(RandomSampler):
    """Uniform with replacement, for every agent from its own memory and with its own generator.

    Args:
        generators: one for each agent.
    """

    def __init__(self, generators: Sequence[torch.Generator]) -> None:
        self._generators = list(generators)
        self._agents = torch.arange(len(self._generators))

    def sample(self, storage: Storage, batch_size: int) -> tuple[tuple[Tensor, Tensor], dict[str, Any]]:
        """Indices of items and of agents, [batch_size, A] each, such that storage[items, agents] is the sample."""
        drawn = [torch.randint(len(storage), (batch_size,), generator=each) for each in self._generators]
        items = torch.stack(drawn, dim=1).to(storage.device)
        return (items, self._agents.to(storage.device).expand_as(items)), {}


def make_replay_buffer(
    capacity: int, batch_size: int, *, device: torch.device | str, generators: Sequence[torch.Generator]
) -> TensorDictReplayBuffer:
    """A ring of the latest `capacity` transitions of every agent, of which `batch_size` are sampled at a time.

    An item is one transition of each agent, a TensorDict of batch size [A]; a sample is [batch_size, A].

    Raises:
        ConfigError: the batch is empty or larger than the memory, or the memory is too large.
    """
    if not 1 <= batch_size <= capacity:
        raise ConfigError(
            f"replay_buffer.batch_size is {batch_size} and capacity is {capacity}; it must be 1 to capacity transitions"
        )
    if capacity > MOST_TRANSITIONS:
        raise ConfigError(f"replay_buffer.capacity is {capacity}; it may be at most {MOST_TRANSITIONS} transitions")
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(capacity, device=device), sampler=AgentSampler(generators), batch_size=batch_size
    )
