"""The replay memory.

Shapes: `A` agents, which fill their memories side by side.
"""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, TensorDictRoundRobinWriter, TensorSpec

from carrl.data.returns import STEPS
from carrl.data.sampler import AgentSampler, PrioritizedAgentSampler
from carrl.errors import ConfigError

KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""What the loss reads of a transition; nothing else is kept, but `STEPS` of one over several steps."""
MOST_TRANSITIONS = 2**27
"""Of a memory: about 10 GB with the default sensor."""


def make_replay_buffer(
    capacity: int, batch_size: int, *, device: torch.device | str, generators: Sequence[torch.Generator]
) -> TensorDictReplayBuffer:
    """A ring of the latest `capacity` transitions of every agent, of which `batch_size` are sampled at a time.

    An item is one transition of each agent, a TensorDict of batch size [A]; a sample is [batch_size, A].

    Raises:
        ConfigError: the batch is empty or larger than the memory, or the memory is too large.
    """
    _check_sizes(capacity, batch_size)
    return _make_buffer(capacity, batch_size, device, AgentSampler(generators))


def make_prioritized_replay_buffer(
    capacity: int,
    batch_size: int,
    alpha: float,
    beta: float,
    *,
    device: torch.device | str,
    generators: Sequence[torch.Generator],
) -> TensorDictReplayBuffer:
    """The buffer of `make_replay_buffer`, but transitions that surprised the network are sampled more often.

    Raises:
        ConfigError: the batch is empty or larger than the memory, or alpha or beta lies outside 0..1.
    """
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not 0 <= value <= 1:
            raise ConfigError(f"replay_buffer.{name} is {value}; it must lie in 0..1")
    _check_sizes(capacity, batch_size)
    return _make_buffer(capacity, batch_size, device, PrioritizedAgentSampler(generators, capacity, alpha, beta))


def memory_of(buffer: TensorDictReplayBuffer) -> dict[Any, Tensor]:
    """What a buffer that is not empty keeps of transitions, [capacity, A, ...] by key: all of it, filled or not."""
    memory = buffer.storage._storage
    return {key: memory[key] for key in (*KEYS, *([STEPS] if STEPS in memory else []))}


def _check_sizes(capacity: int, batch_size: int) -> None:
    if not 1 <= batch_size <= capacity:
        raise ConfigError(
            f"replay_buffer.batch_size is {batch_size} and capacity is {capacity}; it must be 1 to capacity transitions"
        )
    if capacity > MOST_TRANSITIONS:
        raise ConfigError(f"replay_buffer.capacity is {capacity}; it may be at most {MOST_TRANSITIONS} transitions")


def _make_buffer(
    capacity: int, batch_size: int, device: torch.device | str, sampler: AgentSampler
) -> TensorDictReplayBuffer:
    return TensorDictReplayBuffer(
        # "compilable": the length and the cursor are plain numbers, not shared memory, which may be full
        storage=LazyTensorStorage(capacity, device=device, compilable=True),
        writer=TensorDictRoundRobinWriter(compilable=True),
        sampler=sampler,
        batch_size=batch_size,
    )


def contents_of(buffer: TensorDictReplayBuffer) -> dict[str, Any]:
    """The transitions in the ring, [items, A] each, and the place of the next one; not what is not yet filled."""
    items = len(buffer)
    fields = buffer.storage._storage.select(*memory_of(buffer))[:items].flatten_keys("/").to_dict() if items else {}
    return {"fields": fields, "cursor": buffer.writer._cursor}


def restore(buffer: TensorDictReplayBuffer, contents: dict[str, Any], action_spec: TensorSpec) -> None:
    """Fills an empty buffer with the contents of another one of the same capacity.

    Raises:
        ValueError: these are no such contents.
    """
    fields, cursor, capacity = contents["fields"], contents["cursor"], buffer.storage.max_size
    wanted = {"/".join(key) if isinstance(key, tuple) else key for key in KEYS}
    if fields and fields.keys() - {STEPS} != wanted:
        raise ValueError("the transitions in the memory lack something, or have more than is kept")
    items = len(fields["action"]) if fields else 0
    if items > capacity or cursor not in (range(capacity) if items == capacity else [items]):
        raise ValueError(f"{items} transitions with the cursor at {cursor} do not fit a ring of {capacity}")
    if items:
        transitions = TensorDict(fields, batch_size=[items, buffer.sampler.agents]).unflatten_keys("/")
        action = transitions["action"]
        if not action_spec.expand(action.shape).is_in(action):
            raise ValueError("there are actions that no car has")
        buffer.extend(transitions.select(*KEYS, *([STEPS] if STEPS in fields else [])))
    buffer.writer._cursor = cursor
