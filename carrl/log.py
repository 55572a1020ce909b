"""A run's log of transitions, read back: `carrl.log.load("outputs/.../train.mcap")`.

Importing this module needs no torch; `load` does.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from carrl.record.layout import tensordict_of
from carrl.record.reader import LogSummary, TopicSummary, read_attachment, read_columns, read_summary

if TYPE_CHECKING:
    from tensordict import TensorDict

__all__ = ["LogSummary", "TopicSummary", "load", "read_attachment", "read_columns", "read_summary"]


def load(path: str | Path) -> "TensorDict":
    """Loads every transition of a log in TorchRL's layout, ready for a replay buffer.

    Returns:
        Batch size [T], on the CPU: `observation`, `action`, ..., and under `next` what followed, as in
        `carrl.record.schema.COLUMNS`, bit for bit as written; also ("next", "done"), terminated or truncated.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    return tensordict_of(read_columns(path))
