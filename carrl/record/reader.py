"""Reads a finished log: what is in it, its columns, its attachments. Needs no torch.

Shape letters: `T` transitions in the file.
"""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Attachment

from carrl.errors import LogError
from carrl.record.codec import row_shapes
from carrl.record.scan import Scan, quoted_names
from carrl.record.schema import COLUMNS, FORMAT_VERSION, TOPIC, empty_columns

_BATCHES_IN_A_BLOCK = 1024  # joined early: as arrays of their own, batches of one transition take 30 times its memory


@dataclass(frozen=True)
class TopicSummary:
    """How much one topic holds: `message_bytes` counts its messages before compression."""

    messages: int
    message_bytes: int


@dataclass(frozen=True)
class LogSummary:
    """What is in a log.

    Attributes:
        path: the file.
        format_version: the version of the format, an integer.
        file_bytes: its size on disk.
        transitions: how many it holds.
        episodes_ended: how many of them ended an episode, terminated or truncated.
        start_time_s: simulated time of the first batch, s; None without transitions.
        end_time_s: simulated time of the last batch, s; None without transitions.
        topics: by name.
        row_shapes: shape of one transition's value in each column, () or (width,).
        attachments: size of each, bytes.
        metadata: the format's own keys and those of the run.
    """

    path: Path
    format_version: int
    file_bytes: int
    transitions: int
    episodes_ended: int
    start_time_s: float | None
    end_time_s: float | None
    topics: Mapping[str, TopicSummary]
    row_shapes: Mapping[str, tuple[int, ...]]
    attachments: Mapping[str, int]
    metadata: Mapping[str, str]

    @property
    def messages(self) -> int:
        """Batches of transitions."""
        return self.topics[TOPIC].messages

    @property
    def time_span_s(self) -> float:
        """Simulated time between the first and the last batch, s."""
        return (self.end_time_s or 0.0) - (self.start_time_s or 0.0)

    @property
    def bytes_per_transition(self) -> float | None:
        """Bytes on disk, everything included, for each transition; None without transitions."""
        return self.file_bytes / self.transitions if self.transitions else None


def read_summary(path: str | Path) -> LogSummary:
    """Reads through the whole file, one chunk in memory at a time, and says what is in it.

    Raises:
        LogError: not an intact log.
    """
    scan = Scan(Path(path))
    transitions = episodes_ended = 0
    times: list[int] = []  # of the first and the last batch, ns
    for message, columns in scan.batches():
        transitions += len(columns["action"])
        episodes_ended += int((columns["terminated"] | columns["truncated"]).sum())
        times = [min([message.log_time, *times]), max([message.log_time, *times])]
    return LogSummary(
        path=scan.path,
        format_version=FORMAT_VERSION,
        file_bytes=scan.path.stat().st_size,
        transitions=transitions,
        episodes_ended=episodes_ended,
        start_time_s=times[0] / 1e9 if times else None,
        end_time_s=times[1] / 1e9 if times else None,
        topics={topic: TopicSummary(*totals) for topic, totals in scan.topics.items()},
        row_shapes=scan.row_shapes or row_shapes(empty_columns()),
        attachments=scan.attachments,
        metadata=scan.metadata,
    )


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Reads every column, bit for bit as it was written, in the order of writing.

    Returns:
        Each column by name as [T] or [T, width], writable, with the types of `carrl.record.schema.COLUMNS`.

    Raises:
        LogError: not an intact log.
    """
    blocks, batches = [], []
    for _, columns in Scan(Path(path)).batches():
        batches.append(columns)
        if len(batches) == _BATCHES_IN_A_BLOCK:
            blocks.append(_join(batches))
            batches = []
    return _join([*blocks, *batches])


def read_attachment(path: str | Path, name: str) -> bytes:
    """Reads one attachment, such as `config.yaml` or `track.json`.

    Raises:
        LogError: no attachment has this name, or not an intact log.
    """
    scan = Scan(Path(path))
    with closing(scan.records()) as records:
        for record in records:
            if isinstance(record, Attachment) and record.name == name:
                return record.data
    raise LogError(f"log '{path}': has no attachment '{name}'; it has: {quoted_names(scan.attachments)}")


def _join(batches: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Empties the batches, so that a column's pieces are released as soon as the whole column is there."""
    if not batches:
        return empty_columns()
    return {c.name: np.concatenate([batch.pop(c.name) for batch in batches], dtype=c.dtype) for c in COLUMNS}
