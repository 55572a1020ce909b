"""The replay memory.

Shapes: `A` agents, which fill their memories side by side.
"""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import LazyTensorStorage, RandomSampler, Storage, TensorDictReplayBuffer, TensorDictRoundRobinWriter

from carrl.errors import ConfigError
from carrl.generators import restore, states_of
from carrl.sim.vehicle import Action

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

    @property
    def agents(self) -> int:
        """How many agents' memories there are."""
        return len(self._generators)

    def sample(self, storage: Storage, batch_size: int) -> tuple[tuple[Tensor, Tensor], dict[str, Any]]:
        """Indices of items and of agents, [batch_size, A] each, such that storage[items, agents] is the sample."""
        drawn = [torch.randint(len(storage), (batch_size,), generator=each) for each in self._generators]
        items = torch.stack(drawn, dim=1).to(storage.device)
        return (items, self._agents.to(storage.device).expand_as(items)), {}

    def state_dict(self) -> dict[str, Any]:
        """Where every generator stands."""
        return {"generators": states_of(self._generators)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from where the generators stood."""
        restore(self._generators, state_dict["generators"])


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
        # "compilable": the length and the cursor are plain numbers, not shared memory, which may be full
        storage=LazyTensorStorage(capacity, device=device, compilable=True),
        writer=TensorDictRoundRobinWriter(compilable=True),
        sampler=AgentSampler(generators),
        batch_size=batch_size,
    )


def contents_of(buffer: TensorDictReplayBuffer) -> dict[str, Any]:
    """The transitions in the ring, [items, A] each, and the place of the next one; not what is not yet filled."""
    items = len(buffer)
    fields = buffer.storage._storage.select(*KEYS)[:items].flatten_keys("/").to_dict() if items else {}
    return {"fields": fields, "cursor": buffer.writer._cursor}


def put_back(buffer: TensorDictReplayBuffer, contents: dict[str, Any]) -> None:
    """Fills an empty buffer with the contents of another one of the same capacity.

    Raises:
        ValueError: these are no such contents.
    """
    fields, cursor, capacity = contents["fields"], contents["cursor"], buffer.storage.max_size
    items = len(fields["action"]) if fields else 0
    if items > capacity or cursor not in (range(capacity) if items == capacity else [items]):
        raise ValueError(f"{items} transitions with the cursor at {cursor} do not fit a ring of {capacity}")
    if items:
        transitions = TensorDict(fields, batch_size=[items, buffer.sampler.agents]).unflatten_keys("/")
        action = transitions["action"]
        if not ((action >= 0) & (action < len(Action))).all():
            raise ValueError("there are actions that no car has")
        buffer.extend(transitions.select(*KEYS))
    buffer.writer._cursor = cursor
