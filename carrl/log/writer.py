"""Writes a run's log: transitions in batches, ended episodes, metrics.

Shape letters: `T` transitions in a batch.
"""

import contextlib
import logging
import os
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from mcap.records import Message

from carrl.errors import LogError
from carrl.log.codec import Batch, Columns, columns_of, encode_small, pieces
from carrl.log.log_file import begin_log, chunk_beginning, describe, part_path
from carrl.log.mcap_write import McapFile, Position
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import CHANNELS, EPISODES, MESSAGE_NAMES, METRICS, TRANSITIONS, Schema

if TYPE_CHECKING:
    from tensordict import TensorDictBase

_logger = logging.getLogger(__name__)

FLUSH_INTERVAL_S = 0.5
"""Wall time after which what is held back goes to disk with the next batch.

Training hands over a batch at least every second, so that a kill costs about 1.5 s at most.
"""
CHUNK_BYTES = 2**20
"""How many bytes of messages are held back, to be compressed together."""
MIN_FILE_BYTES = 2**20
"""The least size at which a log may be told to go on in another file."""


class LogWriter:
    """A log being written; use it in a `with` statement, or call `close` at the end.

    Attachments and metadata are on disk before the constructor returns. Everything else is compressed in chunks; a
    chunk goes to disk when it is full (1 MiB), or with the first batch that comes 0.5 s or more after the last flush.
    Ended episodes and metrics have chunks of their own, so that they can be listed without unpacking a transition.

    Args:
        path: the file to write; an existing file is replaced.
        envs: log the transitions of the cars 0 to `envs` - 1 only; None for all.
        every_nth_episode: log the transitions of the episodes 0, n, 2n and so on only.
        max_file_bytes: size after which the log goes on in another file, `train-1.mcap` after `train.mcap`; None for
            one file of any size.
        schema: the columns of the transitions.
        attachments: whole files to keep in the log, by name, such as `config.yaml` and `track.json`.
        metadata: what else to say about the run; the keys that the format has itself are taken.
        state: `state_dict` of the writer of a log that was broken off, to go on with it from there. What came after is
            cut off. A log that is gone or not as it was is left alone; it goes on in another file.
        make_room: called where a full disk has no room for the end of the file either.

    Raises:
        LogError: the file cannot be written, `metadata` uses a taken key, or a value is out of its range.
    """

    def __init__(
        self,
        path: str | Path,
        envs: int | None = None,
        every_nth_episode: int = 1,
        max_file_bytes: int | None = None,
        *,
        schema: Schema,
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, str],
        state: Mapping[str, Any] | None = None,
        make_room: Callable[[], None] = lambda: None,
    ) -> None:
        """Creates the file with its attachments and metadata, or opens that of the state."""
        self._first_path = Path(path)
        try:
            self.schema = schema.checked()
        except ValueError as error:
            raise LogError(f"log '{path}': {error}") from error
        _check_range("envs", envs, 1)
        _check_range("every_nth_episode", every_nth_episode, 1)
        _check_range("max_file_bytes", max_file_bytes, MIN_FILE_BYTES)
        self._envs, self._every_nth_episode, self._max_file_bytes = envs, every_nth_episode, max_file_bytes
        self._make_room = make_room
        self._run = secrets.randbits(63)
        self._attachments, self._metadata = dict(attachments), dict(metadata)
        self._last_time = 0
        self._part = 0
        if state is None:
            self._begin_file()
        else:
            self._load_state_dict(state)
        self._chunk_beginning = chunk_beginning(f"{self._run:016x}", self.schema)

    @property
    def path(self) -> Path:
        """The file being written."""
        return part_path(self._first_path, self._part)

    @property
    def closed(self) -> bool:
        """Whether the file is closed, by `close` or by a failure."""
        return self._file.closed

    def state_dict(self) -> dict[str, Any]:
        """Where the log is after all that was written, which is on the disk itself from then on.

        Raises:
            LogError: the log is closed, or the disk fails.
        """
        self._check_open()
        self.flush()
        with self._closing_on_failure():
            self._file.sync()
        return {
            "run": self._run,
            "part": self._part,
            "position": tuple(self._file.position),
            "offset": self._offset,
            "sequences": dict(self._sequences),
            "last_time": self._last_time,
            "columns": self.schema.as_json(),
        }

    def write(self, transitions: "TensorDictBase") -> None:
        """Appends a batch of transitions; an empty one leaves no trace.

        Args:
            transitions: batch size [T], with every key of the schema; other keys are left out. Their times must not
                decrease, nor lie before those of an earlier batch.

        Raises:
            LogError: the log is closed, the disk fails, or the batch does not fit the schema.
        """
        self._check_open()
        try:
            columns = columns_of(transitions, self.schema)
            if len(columns["time_ns"]) == 0:
                return
            times = columns["time_ns"]
            if times[0] < self._last_time or (times[1:] < times[:-1]).any():
                raise ValueError(f"column 'time_ns' decreases, or begins before {self._last_time}, where the log is")
            if self._max_file_bytes is not None and self._file.size >= self._max_file_bytes:
                self.close()
                self._part += 1
                self._begin_file()
            batches = self._batches(self._subset(columns))
            messages = [(batch.encode(), batch.columns["time_ns"]) for batch in batches]
        except ValueError as error:
            raise LogError(f"log '{self.path}': {error}") from error
        self._last_time = int(columns["time_ns"][-1])
        self._offset += sum(batch.count for batch in batches)
        with self._closing_on_failure():
            for content, times in messages:
                self._hold(TRANSITIONS, content, publish_time=int(times[0]), log_time=int(times[-1]))
        if time.monotonic() - self._flushed_at >= FLUSH_INTERVAL_S:
            self.flush()

    def write_episode(self, episode: Episode) -> None:
        """Notes an episode that has ended.

        Raises:
            LogError: the log is closed, or the disk fails.
        """
        self._hold_small(EPISODES, episode, episode.end_ns)

    def write_metrics(self, metrics: Metrics) -> None:
        """Notes how learning goes, at the time of the last transition written.

        Raises:
            LogError: the log is closed, or the disk fails.
        """
        self._hold_small(METRICS, metrics, self._last_time)

    def flush(self) -> None:
        """Hands everything written so far to the operating system, where it outlives this process.

        Raises:
            LogError: the disk fails.
        """
        if self.closed:
            return
        with self._closing_on_failure():
            self._write_held()
        self._flushed_at = time.monotonic()

    def close(self) -> None:
        """Completes the file with its index and closes it; a second call does nothing.

        Raises:
            LogError: the disk fails.
        """
        if self.closed:
            return
        with self._closing_on_failure():
            self._write_held()
            self._file.finish()
            self._file.close()

    def __enter__(self) -> Self:
        """Returns the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the file, also after an error: the transitions up to it are worth keeping."""
        self.close()

    def _begin_file(self) -> None:
        """Everything that counts within a file begins anew."""
        metadata = describe(self._run, self._part, self._metadata, self._attachments)
        self._held: dict[str, list[Message]] = {topic: [] for topic in MESSAGE_NAMES}
        self._held_bytes = self._offset = 0
        self._sequences: Counter[str] = Counter()
        try:
            self._file = begin_log(self.path, metadata, self._attachments, self.schema)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise self._unwritable(error) from error
        self._flushed_at = time.monotonic()

    def _load_state_dict(self, state: Mapping[str, Any]) -> None:
        self._run, self._part = state["run"], state["part"]
        self._last_time = state["last_time"]
        try:
            if state.get("columns") != self.schema.as_json():  # of an older version of the format, for one
                raise ValueError("its columns are others")
            part = self._part + 1  # later ones come anew
            while os.path.lexists(later := part_path(self._first_path, part)):
                later.unlink()
                part += 1
            self._file = McapFile(self.path, Position(*state["position"]))
        except (OSError, ValueError) as error:
            self._leave_alone(self.path, error)
            return
        self._held = {topic: [] for topic in MESSAGE_NAMES}
        self._held_bytes, self._offset = 0, state["offset"]
        self._sequences = Counter(state["sequences"])
        self._flushed_at = time.monotonic()

    def _leave_alone(self, path: Path, error: Exception) -> None:
        """Goes on in the first file that is not there yet."""
        reason = getattr(error, "strerror", None) or error
        while os.path.lexists(self.path) or self.path == path:
            self._part += 1
        _logger.warning("Log '%s' cannot be gone on with: %s. It goes on in '%s'.", path, reason, self.path)
        self._begin_file()

    def _check_open(self) -> None:
        if self.closed:
            raise LogError(f"log '{self.path}': it is closed; write before close(), or open another log")

    def _subset(self, columns: Columns) -> Columns:
        if self._envs is None and self._every_nth_episode == 1:
            return columns
        wanted = columns["episode"] % self._every_nth_episode == 0
        if self._envs is not None:
            wanted &= columns["car"] < self._envs
        return {name: values[wanted] for name, values in columns.items()}

    def _batches(self, columns: Columns) -> list[Batch]:
        batches, offset = [], self._offset
        for piece in pieces(columns):
            batches.append(Batch(self.schema, self._run, offset, piece))
            offset += batches[-1].count
        return batches

    def _hold_small(self, topic: str, message: Episode | Metrics, log_time: int) -> None:
        self._check_open()
        with self._closing_on_failure():
            self._hold(topic, encode_small(topic, self._run, message), publish_time=log_time, log_time=log_time)

    def _hold(self, topic: str, content: bytes, *, publish_time: int, log_time: int) -> None:
        """Keeps a message until enough are there to be compressed together."""
        self._held[topic].append(
            Message(
                channel_id=CHANNELS[topic],
                log_time=log_time,
                publish_time=publish_time,
                sequence=self._sequences[topic] % 2**32,
                data=content,
            )
        )
        self._sequences[topic] += 1
        self._held_bytes += len(content)
        if self._held_bytes >= CHUNK_BYTES:
            self._write_held()

    def _write_held(self) -> None:
        """Writes a chunk of transitions, and one of all else."""
        transitions = self._held[TRANSITIONS]
        others = [message for topic, held in self._held.items() if topic != TRANSITIONS for message in held]
        if transitions:
            self._file.add_chunk(transitions, self._chunk_beginning)
        if others:
            self._file.add_chunk(others)
        self._held = {topic: [] for topic in MESSAGE_NAMES}
        self._held_bytes = 0

    @contextlib.contextmanager
    def _closing_on_failure(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:  # also Ctrl-C
            if not self._file.closed:
                self._finish_somehow()
            self._file.close()
            if isinstance(error, OSError):
                raise self._unwritable(error) from error
            raise

    def _finish_somehow(self) -> None:
        try:
            self._file.finish()
        except OSError:
            self._make_room()
            with contextlib.suppress(OSError):
                self._file.finish()

    def _unwritable(self, error: Exception) -> LogError:
        return LogError(
            f"log '{self.path}': cannot be written: {getattr(error, 'strerror', None) or error}; "
            "give a file in an existing, writable folder on a disk with free space"
        )


def _check_range(name: str, value: int | None, least: int) -> None:
    if value is not None and value < least:
        raise LogError(f"recorder.{name} is {value}; it must be at least {least}")
