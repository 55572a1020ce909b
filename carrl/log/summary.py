"""What is in a log, in a few figures."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from carrl.log.reader import Log
from carrl.log.schema import EPISODES, FORMAT_VERSION


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
        row_shapes: shape of one transition's value in each column, () or (width,).
        attachments: size of each, bytes.
        metadata: the format's own entries and those of the run.
    """

    path: Path
    format_version: int
    file_bytes: int
    transitions: int
    episodes_ended: int
    start_time_s: float | None
    end_time_s: float | None
    messages: Mapping[str, int]
    row_shapes: Mapping[str, tuple[int, ...]]
    attachments: Mapping[str, int]
    metadata: Mapping[str, str]

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
        format_version=FORMAT_VERSION,
        file_bytes=log.file_bytes,
        transitions=log.transitions,
        episodes_ended=log.messages.get(EPISODES, 0),
        start_time_s=None if span is None else span[0] / 1e9,
        end_time_s=None if span is None else span[1] / 1e9,
        messages=log.messages,
        row_shapes=log.row_shapes,
        attachments=log.attachments,
        metadata=log.metadata,
    )
