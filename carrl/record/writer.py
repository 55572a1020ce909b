"""Writes a run's transitions to an MCAP file, one message a batch.

Shape letters: `T` transitions in a batch.
"""

import contextlib
import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from mcap.writer import CompressionType, Writer

from carrl.errors import LogError
from carrl.record.codec import check_row_shapes, encode, pieces, row_shapes
from carrl.record.layout import columns_of
from carrl.record.schema import (
    COLUMNS,
    FORMAT_VERSION,
    MESSAGE_NAME,
    METADATA_NAME,
    TIME_BASE,
    TOPIC,
    schema_bytes,
)

if TYPE_CHECKING:
    from tensordict import TensorDictBase

FLUSH_INTERVAL_S = 1.0
"""Wall time after which the chunk in progress goes to disk."""
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json", ".csv": "text/csv", ".txt": "text/plain"}


class TransitionWriter:
    """A log being written; use it in a `with` statement, or call `close` at the end.

    Attachments and metadata are on disk before the constructor returns. The transitions are compressed in chunks; a
    chunk goes to disk when it is full (1 MiB), or with the first batch that comes 1 s or more after the last flush.

    Args:
        path: the file to write; an existing file is replaced.
        attachments: whole files to keep in the log, by name, such as `config.yaml` and `track.json`.
        metadata: what else to say about the run; the keys `format_version`, `time_base` and `column.*` are taken.

    Raises:
        LogError: the file cannot be written, or `metadata` uses a taken key.
    """

    def __init__(self, path: str | Path, *, attachments: Mapping[str, bytes], metadata: Mapping[str, str]) -> None:
        """Creates the file with its attachments and metadata."""
        self.path = Path(path)
        self._row_shapes: dict[str, tuple[int, ...]] | None = None
        self._messages_written = 0
        described = _describe(self.path, metadata)
        try:
            self._file = open(self.path, "wb")  # noqa: SIM115 (closed in close)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise self._unwritable(error) from error
        self._writer = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        with self._closing_on_failure():
            self._start(attachments, described)

    @property
    def closed(self) -> bool:
        """Whether the file is closed, by `close` or by a failure."""
        return self._file.closed

    def write(self, transitions: "TensorDictBase", time_s: float) -> None:
        """Appends a batch of transitions; an empty one leaves no trace.

        Args:
            transitions: batch size [T], with every key of `carrl.record.schema.COLUMNS`; other keys are left out.
            time_s: simulated time since the start of the run, s, of the whole batch.

        Raises:
            LogError: the log is closed, the disk fails, or the batch does not fit the table of columns.
        """
        if self.closed:
            raise LogError(f"log '{self.path}': it is closed; write before close(), or open another log")
        try:
            log_time = _nanoseconds(time_s)
            columns = columns_of(transitions)
            check_row_shapes(columns, self._row_shapes or row_shapes(columns))
            messages = [encode(piece) for piece in pieces(columns)]
        except ValueError as error:
            raise LogError(f"log '{self.path}': {error}") from error
        if not messages:
            return
        self._row_shapes = row_shapes(columns)
        with self._closing_on_failure():
            for message in messages:
                self._append(message, log_time)
            if time.monotonic() - self._flushed_at >= FLUSH_INTERVAL_S:
                self.flush()

    def flush(self) -> None:
        """Hands everything written so far to the operating system, where it outlives this process."""
        if self.closed:
            return
        with self._closing_on_failure():
            self._writer.flush()
        self._flushed_at = time.monotonic()

    def close(self) -> None:
        """Completes the file with its index and closes it; a second call does nothing."""
        if self.closed:
            return
        with self._closing_on_failure():
            self._writer.finish()
            self._file.close()

    def __enter__(self) -> Self:
        """Returns the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the file, also after an error: the transitions up to it are worth keeping."""
        self.close()

    def _start(self, attachments: Mapping[str, bytes], metadata: dict[str, str]) -> None:
        self._writer.start()
        self._writer.add_metadata(METADATA_NAME, metadata)
        for name, content in attachments.items():
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media_type, content)
        schema_id = self._writer.register_schema(MESSAGE_NAME, "protobuf", schema_bytes())
        self._channel_id = self._writer.register_channel(TOPIC, "protobuf", schema_id)
        self.flush()

    def _append(self, message: bytes, log_time: int) -> None:
        self._writer.add_message(self._channel_id, log_time, message, log_time, self._messages_written)
        self._messages_written += 1

    @contextlib.contextmanager
    def _closing_on_failure(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:  # also Ctrl-C: a record may be half written, and nothing may follow it
            with contextlib.suppress(OSError):  # closing flushes, which fails for the same reason
                self._file.close()
            if isinstance(error, OSError):
                raise self._unwritable(error) from error
            raise

    def _unwritable(self, error: Exception) -> LogError:
        return LogError(
            f"log '{self.path}': cannot be written: {getattr(error, 'strerror', None) or error}; "
            "give a file in an existing, writable folder on a disk with free space"
        )


def _describe(path: Path, metadata: Mapping[str, str]) -> dict[str, str]:
    own = {"format_version": str(FORMAT_VERSION), "time_base": TIME_BASE}
    own |= {f"column.{column.name}": column.description for column in COLUMNS}
    taken = sorted(own.keys() & metadata.keys())
    if taken:
        raise LogError(f"log '{path}': metadata key '{taken[0]}' is the format's own; choose another key")
    return {**own, **metadata}


def _nanoseconds(time_s: float) -> int:
    if not (math.isfinite(time_s) and 0 <= time_s < 2**63 / 1e9):
        raise ValueError(f"time_s is {time_s}; it must be the simulated seconds since the start of the run, 0 or more")
    return round(time_s * 1e9)
