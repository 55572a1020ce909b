"""A run's log, read back: `carrl.log.load("outputs/.../train.mcap")`.

Importing this module needs no torch; `load` and `fill` do.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from carrl.log.codec import Selection, tensordict_of
from carrl.log.messages import Episode, Metrics
from carrl.log.reader import Log
from carrl.log.recovery import Recovery, recover
from carrl.log.schema import EPISODES, Column, Schema
from carrl.log.trace import EpisodeTrace, read_trace
from carrl.log.verification import IntactLog, verify

if TYPE_CHECKING:
    import numpy as np
    from tensordict import TensorDict
    from torchrl.data import ReplayBuffer

__all__ = [
    "Column",
    "Episode",
    "EpisodeTrace",
    "IntactLog",
    "Log",
    "LogSummary",
    "Metrics",
    "Recovery",
    "Schema",
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
    "summarise",
    "verify",
]


@dataclass(frozen=True)
class LogSummary:
    """What is in a log.

    Attributes:
        path: the file.
        format_version: the version of the format, an integer.
        file_bytes: its size on disk.
        transitions: how many it holds.
        episodes_ended: how many episodes are noted as ended.
        start_time_s: simulated time before the first transition, s; None without transitions.
        end_time_s: simulated time before the last transition, s; None without transitions.
        messages: how many each topic has.
        schema: its columns, with what is known of each.
        attachments: size of each, bytes.
        metadata: the format's own entries and those of the run.
        scene_entries: what is known of the world, as `Scene.from_entries` reads it.
    """

    path: Path
    format_version: int
    file_bytes: int
    transitions: int
    episodes_ended: int
    start_time_s: float | None
    end_time_s: float | None
    messages: Mapping[str, int]
    schema: Schema
    attachments: Mapping[str, int]
    metadata: Mapping[str, str]
    scene_entries: Mapping[str, str]

    @property
    def time_span_s(self) -> float:
        """Simulated time between the first and the last transition, s."""
        return (self.end_time_s or 0.0) - (self.start_time_s or 0.0)

    @property
    def bytes_per_transition(self) -> float | None:
        """Bytes on disk, everything included, for each transition; None without transitions."""
        return self.file_bytes / self.transitions if self.transitions else None


def summarise(log: Log) -> LogSummary:
    """Says what is in a log, having read its index and two of its chunks.

    Raises:
        DamagedLogError: not an intact log.
    """
    span = log.span_ns
    return LogSummary(
        path=log.path,
        format_version=log.version,
        file_bytes=log.file_bytes,
        transitions=log.transitions,
        episodes_ended=log.messages.get(EPISODES, 0),
        start_time_s=None if span is None else span[0] / 1e9,
        end_time_s=None if span is None else span[1] / 1e9,
        messages=log.messages,
        schema=log.schema,
        attachments=log.attachments,
        metadata=log.metadata,
        scene_entries=log.scene_entries,
    )


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
        Batch size [T], on the CPU: `observation`, `action`, ..., and under `next` what followed, by the keys of the
        log's columns, bit for bit as written; also ("next", "done"), terminated or truncated, and `pose`.

    Raises:
        LogError: the file is missing, or not an intact log.
    """
    with Log(path) as log:
        return tensordict_of(log.columns(Selection(episodes, envs, begin_s, end_s)), log.schema)


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
                buffer.extend(tensordict_of(columns, log.schema))
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
