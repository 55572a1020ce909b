"""Which parts do not go together."""

from collections.abc import Mapping
from typing import Any

from torchrl.data import TensorDictReplayBuffer
from torchrl.objectives import DQNLoss

from carrl.algorithms.dqn.loss import ConservativeDQNLoss
from carrl.data.sampler import PrioritizedAgentSampler
from carrl.errors import ConfigError


def check_priorities(loss: DQNLoss, buffer: TensorDictReplayBuffer) -> None:
    """Raises ConfigError if the buffer's weights would count for a part of the loss only."""
    if isinstance(loss, ConservativeDQNLoss) and isinstance(buffer.sampler, PrioritizedAgentSampler):
        raise ConfigError(
            "loss is cql, whose conservative term weighs all transitions alike, and replay_buffer is prioritized; "
            "set replay_buffer=uniform, or another loss"
        )


def has_n_step_returns(config: Mapping[str, Any]) -> bool:
    """Whether returns are over several steps."""
    node = config.get("returns")
    return isinstance(node, Mapping) and node.get("steps", 1) != 1


def check_offline(config: Mapping[str, Any]) -> None:
    """Raises ConfigError if returns over several steps are to be learnt from a log."""
    if has_n_step_returns(config):
        raise ConfigError(
            "returns are over several steps, which a log may not have in full, and data is log; set returns.steps=1"
        )
