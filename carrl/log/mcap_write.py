"""An MCAP file being written, whole at every moment up to its last record.

The `mcap` package's writer cannot go on after a write that failed half way. This one appends records whole or not at
all, so that a full disk costs only what did not fit; it serialises with that package's records.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import fcntl
import mmap
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from carrl.files import open_itself
from carrl.log.mcap_records import HEAD, Content, McapIndex, parse, records

LIBRARY = "carrl"
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS_BYTES = 22
_FOOTER_START = struct.Struct("<BQQQ")
_READ_AT_ONCE = 2**24


class Position(NamedTuple):
    """How far an unfinished file was written.

    Attributes:
        size: bytes.
        crc: CRC-32 of them all.
    """

    size: int
    crc: int


class McapFile:
    """Appends to a file. After a failed append it is as before, and may be finished. Nothing is buffered here.

    Args:
        path: of a new file, an existing one being replaced; a link in its place is not followed.
        position: where to go on with the existing file instead, which is cut off there.

    Raises:
        OSError: the file cannot be made or opened; appending raises OSError, too.
        ValueError: the path is invalid, or the file is not as it was at the position.
    """

    def __init__(self, path: Path, position: Position | None = None) -> None:
        """Begins the file, or goes on with it."""
        mode = "w+b" if position is None else "r+b"
        self._file = open(path, mode, buffering=0, opener=open_itself)  # noqa: SIM115 (closed in close)
        with suppress(OSError):  # some network file systems know no locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # by which readers know that it is being written
        self._index = McapIndex()
        self._compressor = zstandard.ZstdCompressor(level=3)
        self._crc = self.size = 0
        try:
            if position is None:
                self._append(MCAP0_MAGIC + serialise(Header(profile="", library=LIBRARY)))
            else:
                self._go_on_at(position)
        except BaseException:
            self.close()
            raise

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    @property
    def position(self) -> Position:
        """How far it is written."""
        return Position(self.size, self._crc)

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Appends a record of entries."""
        self._add(Metadata(name=name, metadata=dict(entries)))

    def add_attachment(self, name: str, media_type: str, content: bytes) -> None:
        """Appends a whole file, at time 0."""
        self._add(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content))

    def add_channel(self, schema: Schema, channel: Channel) -> None:
        """Appends a topic; both records are in the summary again, and so under its CRC."""
        self._add(schema)
        self._add(channel)

    def add_chunk(self, messages: Sequence[Message], beginning: bytes = b"") -> None:
        """Appends messages as one compressed chunk with its index, behind the records that it is to begin with."""
        content, indices = _pack(messages, beginning)
        times = [message.log_time for message in messages]
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(content),
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        packed, offset = serialise(chunk), self.size
        index_records = [serialise(index) for index in indices]
        self._append(packed + b"".join(index_records))
        self._index.add_chunk(chunk, offset, len(packed))
        place = offset + len(packed)
        for index, record in zip(indices, index_records, strict=True):
            self._index.add_messages(index.channel_id, len(index.records), place, len(record))
            place += len(record)

    def finish(self) -> None:
        """Completes the file with its summary; nothing can be appended afterwards."""
        data_end = serialise(DataEnd(data_section_crc=self._crc))
        self._append(data_end + _ending(self._index, self.size + len(data_end)))

    def sync(self) -> None:
        """Waits until what is written is on the disk itself, where it outlives the machine's power."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Closes the file as it is; a second call does nothing."""
        self._file.close()

    def _add(self, record: McapRecord) -> None:
        content = serialise(record)
        self._index.add(record, self._append(content), len(content))

    def _go_on_at(self, position: Position) -> None:
        if os.fstat(self._file.fileno()).st_size < position.size or position.size < len(MCAP0_MAGIC):
            raise ValueError(f"it has fewer than {position.size} bytes")
        with mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            crc = 0
            for offset in range(0, position.size, _READ_AT_ONCE):
                crc = zlib.crc32(content[offset : min(offset + _READ_AT_ONCE, position.size)], crc)
            if crc != position.crc:
                raise ValueError(f"its first {position.size} bytes are others than were written")
            self._index = _index_up_to(content, position.size)
        os.ftruncate(self._file.fileno(), position.size)
        self.size, self._crc = position

    def _append(self, content: bytes) -> int:
        """Writes at the end, whole or not at all, and returns the offset."""
        offset = self.size
        try:
            _write_at(self._file.fileno(), content, offset)
        except BaseException:  # also Ctrl-C
            with suppress(OSError):
                os.ftruncate(self._file.fileno(), offset)
            raise
        self._crc = zlib.crc32(content, self._crc)
        self.size = offset + len(content)
        return offset


def serialise(*written: McapRecord) -> bytes:
    """The records as bytes, one after the other."""
    builder = RecordBuilder()
    for record in written:
        record.write(builder)
    return bytes(builder.end())


def _write_at(descriptor: int, content: bytes, offset: int) -> None:
    rest = memoryview(content)
    while rest:
        written = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[written:], offset + written


def _pack(messages: Sequence[Message], beginning: bytes) -> tuple[bytes, list[MessageIndex]]:
    """The content of a chunk and, for each channel, where in it its messages begin."""
    parts: list[bytes] = [beginning]
    places: dict[int, list[tuple[int, int]]] = {}
    size = len(beginning)
    for message in messages:
        places.setdefault(message.channel_id, []).append((message.log_time, size))
        head = _MESSAGE_HEAD.pack(
            Opcode.MESSAGE,
            _MESSAGE_FIELDS_BYTES + len(message.data),
            message.channel_id,
            message.sequence,
            message.log_time,
            message.publish_time,
        )
        parts += (head, message.data)
        size += len(head) + len(message.data)
    return b"".join(parts), [MessageIndex(channel_id=channel, records=found) for channel, found in places.items()]


def _index_up_to(content: Content, size: int) -> McapIndex:
    """The index of an unfinished file's records up to `size` bytes.

    Raises:
        ValueError: these are not whole records.
    """
    index = McapIndex()
    for opcode, begin, end in records(content, len(MCAP0_MAGIC), size):
        record, offset, length = parse(opcode, content[begin:end]), begin - HEAD.size, end - begin + HEAD.size
        if isinstance(record, Chunk):
            index.add_chunk(record, offset, length)
        elif isinstance(record, MessageIndex):
            index.add_messages(record.channel_id, len(record.records), offset, length)
        else:
            index.add(record, offset, length)
    return index


def _ending(index: McapIndex, begin: int) -> bytes:
    """The summary section, which begins at `begin`, with its offsets, the footer and the closing magic."""
    groups: dict[Opcode, Sequence[McapRecord]] = {
        Opcode.SCHEMA: list(index.schemas.values()),
        Opcode.CHANNEL: list(index.channels.values()),
        Opcode.STATISTICS: [_statistics(index)],
        Opcode.CHUNK_INDEX: index.chunks,
        Opcode.ATTACHMENT_INDEX: index.attachments,
        Opcode.METADATA_INDEX: index.metadata,
    }
    content, offsets = b"", []
    for opcode, members in groups.items():
        group = serialise(*members)
        if group:
            place = SummaryOffset(group_opcode=opcode, group_start=begin + len(content), group_length=len(group))
            offsets.append(place)
        content += group
    offset_start = begin + len(content)
    content += serialise(*offsets)
    footer_start = _FOOTER_START.pack(Opcode.FOOTER, 20, begin, offset_start)
    crc = zlib.crc32(footer_start, zlib.crc32(content))
    footer = Footer(summary_start=begin, summary_offset_start=offset_start, summary_crc=crc)
    return content + serialise(footer) + MCAP0_MAGIC


def _statistics(index: McapIndex) -> Statistics:
    """How many records and messages there are, and from when to when."""
    return Statistics(
        attachment_count=len(index.attachments),
        channel_count=len(index.channels),
        channel_message_counts=dict(index.messages),
        chunk_count=len(index.chunks),
        message_count=index.messages.total(),
        message_start_time=min((chunk.message_start_time for chunk in index.chunks), default=0),
        message_end_time=max((chunk.message_end_time for chunk in index.chunks), default=0),
        metadata_count=len(index.metadata),
        schema_count=len(index.schemas),
    )
