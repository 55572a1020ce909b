"""Reads a log, finished or being written: its transitions, episodes and metrics. Needs no torch.

Everything goes through the file's index, so that one episode of a large log is read in the time of a few chunks, and no
more than a chunk is in memory at once.

Shape letters: `T` transitions.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.records import ChunkIndex, Message

from carrl.errors import DamagedLogError, LogError
from carrl.log import version2
from carrl.log.codec import EVERYTHING, Batch, Columns, Selection, decode_small, episode_span
from carrl.log.log_file import ATTACHMENT, content_checksum, is_intact
from carrl.log.mcap_read import IndexedFile, damaged
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import (
    COLUMNS_ENTRY,
    EPISODES,
    FORMAT_VERSION,
    MESSAGE_NAMES,
    METADATA_NAME,
    METRICS,
    RECOVERY_NAME,
    TRANSITIONS,
    Schema,
)

_BATCHES_IN_A_BLOCK = 1024  # joined early: as arrays of their own, batches of one transition take 30 times its memory


class Log:
    """A log, finished or as far as it is written yet, opened; use it in a `with` statement.

    Attributes:
        path: the file.
        metadata: the entries of the record "carrl".
        scene_entries: what they say of the world, as `Scene.from_entries` reads it.
        version: of the format.
        file_schema: the columns of the file.
        schema: the columns that the methods yield: the same, but for those of an older version.

    Raises:
        LogError: the file cannot be read, or has no attachment of the name asked for.
        DamagedLogError: it is not an intact log of this format; what the methods read, they check then.
    """

    def __init__(self, path: str | Path) -> None:
        """Reads the file's index and metadata."""
        self.path = Path(path)
        self._file = IndexedFile(self.path)
        try:
            self.metadata: Mapping[str, str] = self._read_metadata()
            self.version = int(self.metadata["format_version"])
            self._topics = self._read_topics()
            self.file_schema = self.schema = self._read_schema()
            self.scene_entries = self.metadata
            if self.version == version2.VERSION:
                older = version2.Version2(self.file_schema, self.metadata)
                self.schema, self.scene_entries = older.schema, older.scene_entries
        except BaseException:
            self._file.__exit__(None, None, None)
            raise

    def __enter__(self) -> Self:
        """Returns the log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes the file."""
        self._file.__exit__(kind, error, trace)

    @property
    def file_bytes(self) -> int:
        """Size of the file."""
        return self._file.size

    @property
    def messages(self) -> Mapping[str, int]:
        """How many messages each topic has."""
        counts = dict.fromkeys(self._topics.values(), 0)
        for channel, topic in self._topics.items():  # several may have one topic, as where files were merged
            counts[topic] += self._file.index.messages.get(channel, 0)
        return counts

    @property
    def attachments(self) -> Mapping[str, int]:
        """Size of each attachment by name, bytes."""
        return {entry.name: entry.data_size for entry in self._file.index.attachments}

    @property
    def recovery(self) -> Mapping[str, str]:
        """What `carrl log recover` noted when it made this log, as JSON by name; empty if it did not."""
        found = [entry for entry in self._file.index.metadata if entry.name == RECOVERY_NAME]
        return self._file.read_metadata(found[0]).metadata if found else {}

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Simulated times of the first and the last transition, ns; None without transitions."""
        ends = self._end_batches
        if not ends:
            return None
        return int(ends[0].columns["time_ns"][0]), int(ends[-1].columns["time_ns"][-1])

    @property
    def transitions(self) -> int:
        """How many transitions it holds."""
        ends = self._end_batches
        return ends[-1].offset + ends[-1].count if ends else 0

    def attachment(self, name: str) -> bytes:
        """The content of an attachment, such as `config.yaml` or `track.json`."""
        for entry in self._file.index.attachments:
            if entry.name == name:
                content = self._file.read_attachment(entry).data
                if content_checksum(content) != self.metadata.get(ATTACHMENT + name, content_checksum(content)):
                    raise damaged(self.path, f"its attachment {name!r:.40} is not the one that its metadata tells of")
                return content
        raise LogError(f"log '{self.path}': has no attachment '{name}'; it has: {quoted_names(self.attachments)}")

    def batches(self, selection: Selection = EVERYTHING) -> Iterator[Columns]:
        """Yields the selected transitions in the order of writing, some thousands at a time.

        Each column is [T] or [T, width], writable, with the type of the schema.
        """
        for columns in self._batches(selection):
            yield self._join([columns])

    def coded_batches(self, selection: Selection = EVERYTHING) -> Iterator[Batch]:
        """Yields, as they were written, the messages of transitions among which the selected ones are."""
        return self._decoded(self._chunks_of(selection))

    def columns(self, selection: Selection = EVERYTHING) -> Columns:
        """The selected transitions all at once, as `batches` yields them."""
        blocks, batches = [], []
        for columns in self._batches(selection):
            batches.append(columns)
            if len(batches) == _BATCHES_IN_A_BLOCK:
                blocks.append(self._join(batches))
                batches = []
        return self._join([*blocks, *batches])

    def episodes(self) -> Iterator[Episode]:
        """Yields the ended episodes in the order in which they ended."""
        for message in self._small(EPISODES):
            assert isinstance(message, Episode)
            yield message

    def metrics(self) -> Iterator[Metrics]:
        """Yields the messages about the learning in their order."""
        for message in self._small(METRICS):
            assert isinstance(message, Metrics)
            yield message

    def _batches(self, selection: Selection) -> Iterator[Columns]:
        """As `batches`, but read-only and with the types in the file."""
        older = version2.Version2(self.file_schema, self.metadata) if self.version == version2.VERSION else None
        for batch in self.coded_batches(selection):
            selected = selection.of(older.columns(batch.columns) if older else batch.columns)
            if len(selected["action"]):
                yield dict(selected)

    def _small(self, topic: str) -> Iterator[Episode | Metrics]:
        for message in self._raw(topic):
            with self._naming(message, topic):
                run, small = decode_small(topic, message.data)
                self._check_run(run)
            yield small

    def _raw(self, topic: str) -> Iterator[Message]:
        for chunk in self._chunks_with(topic):
            yield from self._messages(chunk, topic)

    def _decoded(self, chunks: Iterable[ChunkIndex]) -> Iterator[Batch]:
        for chunk in chunks:
            for message in self._messages(chunk, TRANSITIONS):
                with self._naming(message):
                    batch = Batch.decode(message.data, self.file_schema)
                    self._check_run(batch.run)
                yield batch

    @contextmanager
    def _naming(self, message: Message, topic: str = "") -> Iterator[None]:
        """Says which message it is that is wrong."""
        try:
            yield
        except ValueError as error:
            of = f" of {topic}" if topic else ""
            raise self._wrong(f"message {message.sequence}{of} is wrong: {error}") from error

    def _check_run(self, run: int) -> None:
        if f"{run:016x}" != self.metadata.get("run"):
            raise ValueError("it is of another run than the metadata")

    def _messages(self, chunk: ChunkIndex, topic: str) -> Iterator[Message]:
        for message in self._file.messages(chunk):
            if self._topics.get(message.channel_id) == topic:
                yield message

    def _chunks_with(self, topic: str) -> list[ChunkIndex]:
        channels = {channel for channel, name in self._topics.items() if name == topic}
        return [
            chunk
            for chunk in self._file.index.chunks
            if not chunk.message_index_offsets or channels & chunk.message_index_offsets.keys()
        ]

    def _chunks_of(self, selection: Selection) -> Iterator[ChunkIndex]:
        """The chunks that may hold a selected transition: each spans the time from the last one before it on.

        The end of a chunk that holds other messages, too, may be theirs; its begin is no later than any transition's.
        """
        chunks = self._chunks_with(TRANSITIONS)
        spans = self._spans_of(selection)
        chunk_begin = -np.inf
        for chunk in chunks:
            if any(begin <= chunk.message_end_time and chunk_begin <= end for begin, end in spans):
                yield chunk
            alone = len(chunk.message_index_offsets) == 1
            chunk_begin = chunk.message_end_time if alone else chunk.message_start_time

    def _spans_of(self, selection: Selection) -> list[tuple[float, float]]:
        """Times, ns, within which all selected transitions lie."""
        begin, end = selection.span_ns
        wanted = selection.episodes
        if wanted is None:
            return [(begin, end)]
        found = {number: span for number, *span in self._episode_spans() if number in wanted}
        if len(found) < len(set(wanted)):  # one that never ended may be anywhere
            return [(begin, end)]
        return [(max(begin, first), min(end, last)) for first, last in found.values()]

    def _episode_spans(self) -> Iterator[tuple[int, int, int]]:
        """Number, begin and end, ns, of each ended episode."""
        for message in self._raw(EPISODES):
            with self._naming(message, EPISODES):
                span = episode_span(message.data)
            yield span

    @cached_property
    def _end_batches(self) -> list[Batch]:
        """The first and the last batch; one and the same if there is but one."""
        chunks = self._chunks_with(TRANSITIONS)
        lasts = (batch for chunk in reversed(chunks) for batch in list(self._decoded([chunk]))[-1:])
        return [*islice(self._decoded(chunks), 1), *islice(lasts, 1)]

    def _read_metadata(self) -> dict[str, str]:
        entries = self._only_one(
            [
                self._file.read_metadata(entry).metadata
                for entry in self._file.index.metadata
                if entry.name == METADATA_NAME
            ]
        )
        version = entries.get("format_version")
        if version not in (str(version2.VERSION), str(FORMAT_VERSION)):
            raise LogError(
                f"log '{self.path}': has format version {version!r:.20}, this carrl reads {version2.VERSION} and "
                f"{FORMAT_VERSION}; use the version of carrl that wrote it"
            )
        if not is_intact(entries):
            raise damaged(self.path, "its metadata does not have the checksum that was stored")
        return entries

    def _only_one(self, found: list[dict[str, str]]) -> dict[str, str]:
        """What all of these metadata records say, if they are of one and the same log."""
        if not found:
            raise self._wrong(f"no metadata record '{METADATA_NAME}'")
        runs = sorted({entries.get("run", "") for entries in found})
        parts = {(entries.get("run"), entries.get("part")) for entries in found}
        if len(runs) > 1:
            raise LogError(
                f"log '{self.path}': holds {len(runs)} logs merged into one file, of the runs {quoted_names(runs)}; "
                "carrl reads one run a file, so write each to one of its own with: carrl log recover IN OUT --run RUN"
            )
        if len(parts) > 1:
            raise LogError(
                f"log '{self.path}': holds {len(parts)} parts of one run merged into one file; "
                "carrl reads one part a file, so give the files that they were merged from"
            )
        return found[0]

    def _read_topics(self) -> dict[int, str]:
        """The topics of this format by their channels' numbers."""
        topics = {}
        for number, channel in self._file.index.channels.items():
            schema = self._file.index.schemas.get(channel.schema_id)
            kind = (channel.message_encoding, schema.encoding, schema.name) if schema else None
            name = MESSAGE_NAMES.get(channel.topic)
            if name is not None:
                if kind != ("protobuf", "protobuf", name):
                    raise self._wrong(f"topic {channel.topic} has the schema {kind!r:.100}, not {name} in protobuf")
                if channel.metadata.get("run", self.metadata.get("run")) != self.metadata.get("run"):
                    raise damaged(self.path, "its metadata is that of another run")
                topics[number] = channel.topic
        if not topics:
            raise self._wrong(f"no topic {TRANSITIONS} among: none")
        if TRANSITIONS not in topics.values():
            raise damaged(self.path, f"it has no topic {TRANSITIONS}, which every log has")
        return topics

    def _read_schema(self) -> Schema:
        """The columns of the file: as its channels describe them, or for version 2 as its first message shows them."""
        if self.version == version2.VERSION:
            for message in self._raw(TRANSITIONS):
                with self._naming(message):
                    return version2.file_schema(message.data)
            return version2.NO_WIDTHS
        channels = [channel for channel in self._file.index.channels.values() if channel.topic == TRANSITIONS]
        descriptions = {channel.metadata.get(COLUMNS_ENTRY, "") for channel in channels}
        if len(descriptions) > 1:
            raise self._wrong(f"its {len(channels)} topics {TRANSITIONS} have different columns")
        try:
            return Schema.from_json(descriptions.pop())
        except ValueError as error:
            raise self._wrong(str(error)) from error

    def _join(self, batches: list[Columns]) -> Columns:
        """Empties the batches, so that a column's pieces are released as soon as the whole column is there."""
        if not batches:
            return self.schema.empty()
        return {
            c.name: np.concatenate([batch.pop(c.name) for batch in batches], dtype=c.dtype) for c in self.schema.columns
        }

    def _wrong(self, found: str) -> DamagedLogError:
        return DamagedLogError(f"log '{self.path}': is not a CarRL log: {found}; give the train.mcap of a run")


def quoted_names(names: Iterable[str]) -> str:
    """Quoted and cut, for a file may hold any text as a name."""
    return f"{', '.join(map(repr, names)) or 'none':.200}"
