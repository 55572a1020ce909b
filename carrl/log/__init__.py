"""A run's log, read back: `carrl.log.load("outputs/.../train.mcap")`.

Importing this module needs no torch; `load` and `fill` do.
"""

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from carrl.log.layout import tensordict_of
from carrl.log.messages import Episode, Metrics
from carrl.log.reader import Log
from carrl.log.recovery import Recovery, recover
from carrl.log.selection import Selection
from carrl.log.summary import LogSummary, summarise
from carrl.log.trace import EpisodeTrace, read_trace
from carrl.log.verification import IntactLog, verify

if TYPE_CHECKING:
    import numpy as np
    from tensordict import TensorDict
    from torchrl.data import ReplayBuffer

__all__ = [
    "Episode",
    "EpisodeTrace",
    "IntactLog",
    "Log",
    "LogSummary",
    "Metrics",
    "Recovery",
    "Selection",
    "fill",
    "load",
    "read_attachment",
    "read_columns",
    "read_episodes",
    "read_metadata",
    "read_metrics",
    "read_summary",
    "read_trace",
    "recover",
    "verify",
]


def load(
    path: str | Path,
    *,
    episodes: Collection[int] | None = None,
    envs: Collection[int] | None = None,
    begin_s: float | None = None,
    end_s: float | None = None,
) -> "TensorDict":
    """Loads a log's transitions in TorchRL's layout, ready for a replay buffer.

    Args:
        path: the log.
        episodes: numbers of the episodes wanted; None for all.
        envs: indices of the cars wanted; None for all.
        begin_s: simulated time of the first transition, s.
        end_s: simulated time before which the last one begins, s.

    Returns:
        Batch size [T], on the CPU: `observation`, `action`, ..., and under `next` what followed, as in
        `carrl.log.schema.COLUMNS`, bit for bit as written; also ("next", "done"), terminated or truncated.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return tensordict_of(log.columns(Selection(episodes, envs, begin_s, end_s)))


def fill(buffer: "ReplayBuffer", paths: str | Path | Iterable[str | Path], selection: Selection | None = None) -> int:
    """Extends a replay buffer by the transitions of one or several logs, some thousands in memory at a time.

    Returns:
        How many there were.

    Raises:
        LogError: a file is missing, or not an intact log; what was read before is in the buffer then.
    """
    count = 0
    for path in [paths] if isinstance(paths, str | Path) else paths:
        with Log(path) as log:
            for columns in log.batches(selection or Selection()):
                buffer.extend(tensordict_of(columns))
                count += len(columns["action"])
    return count


def read_columns(path: str | Path, selection: Selection | None = None) -> "dict[str, np.ndarray]":
    """Reads the transitions as arrays, [T] or [T, width] by the column's name, bit for bit as they were written.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return log.columns(selection or Selection())


def read_episodes(path: str | Path) -> list[Episode]:
    """Reads the ended episodes, in the order in which they ended.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return list(log.episodes())


def read_metrics(path: str | Path) -> list[Metrics]:
    """Reads how learning went.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return list(log.metrics())


def read_attachment(path: str | Path, name: str) -> bytes:
    """Reads one attachment, such as `config.yaml` or `track.json`.

    Raises:
        LogError: no attachment has this name, or not an intact log.
    """
    with Log(path) as log:
        return log.attachment(name)


def read_metadata(path: str | Path) -> dict[str, str]:
    """Reads what the log says of its run: seed, packages, sensors and so on.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return dict(log.metadata)


def read_summary(path: str | Path) -> LogSummary:
    """Says what is in a log, without reading it all.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return summarise(log)
