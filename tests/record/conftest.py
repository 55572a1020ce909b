"""Transitions to write, and a small log of them."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from carrl.record.writer import TransitionWriter


@pytest.fixture
def transitions() -> Callable[..., TensorDict]:
    """Makes T transitions of cars with R rays; every value of every column is distinct where its type allows."""

    def make(count: int, rays: int = 7, seed: int = 0) -> TensorDict:
        generator = torch.Generator().manual_seed(seed)

        def noise(*shape: int) -> torch.Tensor:
            return torch.randn((count, *shape), generator=generator)

        following = {
            "reward": noise(1),
            "reward_terms": noise(4),
            "observation": noise(rays),
            "terminated": noise(1) > 0,
            "truncated": noise(1) > 0,
        }
        return TensorDict(
            {
                "observation": noise(rays),
                "action": torch.randint(3, (count,), generator=generator),
                "episode": torch.arange(count) // 5,
                "step": torch.arange(count) % 5,
                "env": torch.arange(count) % 3,
                "pose": noise(3),
                "action_value": noise(3),
                "epsilon": noise(),
                "exploratory": noise() > 0,
                "track": torch.arange(count) % 2,
                "next": TensorDict(following, [count]),
            },
            [count],
        )

    return make


@pytest.fixture
def log_path(tmp_path: Path, transitions: Callable[..., TensorDict]) -> Path:
    """A finished log of 9 transitions in three batches, with two attachments."""
    path = tmp_path / "train.mcap"
    attachments = {"config.yaml": b"seed: 1\n", "track.json": b'{"name": "oval"}'}
    with TransitionWriter(path, attachments=attachments, metadata={"track": "oval"}) as writer:
        for batch, count in enumerate((4, 1, 4)):
            writer.write(transitions(count, seed=batch), time_s=0.1 * batch)
    return path
