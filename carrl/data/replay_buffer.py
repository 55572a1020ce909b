"""The replay memory."""

import torch
from torchrl.data import LazyTensorStorage, RandomSampler, TensorDictReplayBuffer

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


def make_replay_buffer(
    capacity: int, batch_size: int, *, device: torch.device | str, generator: torch.Generator
) -> TensorDictReplayBuffer:
    """A ring of the latest `capacity` transitions, sampled uniformly with replacement, `batch_size` at a time.

    Raises:
        ConfigError: the batch is empty or larger than the memory.
    """
    if not 1 <= batch_size <= capacity:
        raise ConfigError(
            f"replay_buffer.batch_size is {batch_size} and capacity is {capacity}; it must be 1 to capacity transitions"
        )
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(capacity, device=device),
        sampler=RandomSampler(),
        batch_size=batch_size,
        generator=generator,
    )
