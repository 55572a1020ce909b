"""Transitions to write, and a small log of them."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from carrl.log.messages import Episode, Metrics
from carrl.log.writer import LogWriter
from tests.logs import make_schema


@pytest.fixture
def transitions() -> Callable[..., TensorDict]:
    """Makes T transitions of cars with R rays; every value of every column is distinct where its type allows.

    Their times go on from one call to the next, as those of a run do: one transition each tenth of a second.
    """
    made = 0

    def make(count: int, rays: int = 7, seed: int = 0) -> TensorDict:
        nonlocal made
        begin, made = made, made + count
        generator = torch.Generator().manual_seed(seed)

        def noise(*shape: int) -> torch.Tensor:
            return torch.randn((count, *shape), generator=generator)

        following = {
            "reward": noise(1),
            "reward_terms": noise(4),
            "observation": noise(rays),
            "terminated": noise(1) > 0,
            "truncated": noise(1) > 0,
            "pose": noise(3),
            "gates_passed": torch.arange(count) + 1,
        }
        return TensorDict(
            {
                "observation": noise(rays),
                "action": torch.randint(3, (count,), generator=generator),
                "episode": torch.arange(count) // 5,
                "step": torch.arange(count) % 5,
                "car": torch.arange(count) % 3,
                "next_gate": torch.arange(count) % 4,
                "gates_passed": torch.arange(count),
                "pose": noise(3),
                "action_value": noise(3),
                "epsilon": noise(),
                "exploratory": noise() > 0,
                "track": torch.arange(count) % 2,
                "time_ns": torch.arange(begin, made) * 100_000_000,
                "next": TensorDict(following, [count]),
            },
            [count],
        )

    return make


@pytest.fixture
def log_path(tmp_path: Path, transitions: Callable[..., TensorDict]) -> Path:
    """A finished log of 9 transitions in three batches, two episodes and one message of metrics, two attachments."""
    path = tmp_path / "train.mcap"
    attachments = {"config.yaml": b"seed: 1\n", "track.json": b'{"name": "oval"}'}
    with LogWriter(path, schema=make_schema(), attachments=attachments, metadata={"track": "oval"}) as writer:
        for batch, count in enumerate((4, 1, 4)):
            writer.write(transitions(count, seed=batch))
        writer.write_episode(Episode(0, 2, 0, 5, 0, 500_000_000, -149.5, 5, 1, 0, "collision", (1.0, -2.5, 0.75)))
        writer.write_episode(
            Episode(1, 0, 1, 9, 500_000_000, 900_000_000, 400.0, 4, 8, 1, "time limit", (0.5, 0.0, -3.0))
        )
        writer.write_metrics(Metrics(9, 3, 0.25, 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.99}))
    return path
