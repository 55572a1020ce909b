"""An MCAP file being written, whole at every moment up to its last record.

The `mcap` package's writer cannot go on after a write that failed half way. This one appends records whole or not at
all, so that a full disk costs only what did not fit; it serialises with that package's records.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

LIBRARY = "carrl"
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS_BYTES = 22
_FOOTER_START = struct.Struct("<BQQQ")


@dataclass
class _Summary:
    """What the end of the file tells of the rest of it."""

    schemas: list[McapRecord] = field(default_factory=list)
    channels: list[McapRecord] = field(default_factory=list)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[McapRecord] = field(default_factory=list)
    metadata: list[McapRecord] = field(default_factory=list)
    messages: Counter[int] = field(default_factory=Counter)

    def statistics(self) -> Statistics:
        """How many records and messages there are, and from when to when."""
        starts = [chunk.message_start_time for chunk in self.chunks]
        ends = [chunk.message_end_time for chunk in self.chunks]
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.messages),
            chunk_count=len(self.chunks),
            message_count=self.messages.total(),
            message_start_time=min(starts, default=0),
            message_end_time=max(ends, default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )

    def groups(self) -> dict[Opcode, list[McapRecord]]:
        """The records of the summary section by kind, in their order."""
        return {
            Opcode.SCHEMA: self.schemas,
            Opcode.CHANNEL: self.channels,
            Opcode.STATISTICS: [self.statistics()],
            Opcode.CHUNK_INDEX: list(self.chunks),
            Opcode.ATTACHMENT_INDEX: self.attachments,
            Opcode.METADATA_INDEX: self.metadata,
        }


class McapFile:
    """Appends to a new file, an existing one of this path being replaced.

    After a failed append the file is as before, and may be finished. Nothing is buffered here.

    Raises:
        OSError, ValueError: the file cannot be made; appending raises OSError, too.
    """

    def __init__(self, path: Path) -> None:
        """Makes the file and begins it."""
        self._file = open(path, "wb", buffering=0)  # noqa: SIM115 (closed in close)
        self._summary = _Summary()
        self._compressor = zstandard.ZstdCompressor(level=3)
        self._crc = 0
        self.size = 0
        try:
            self._append(MCAP0_MAGIC + _serialise(Header(profile="", library=LIBRARY)))
        except BaseException:
            self.close()
            raise

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Appends a record of entries."""
        record = _serialise(Metadata(name=name, metadata=dict(entries)))
        offset = self._append(record)
        self._summary.metadata.append(MetadataIndex(offset=offset, length=len(record), name=name))

    def add_attachment(self, name: str, media_type: str, content: bytes) -> None:
        """Appends a whole file, at time 0."""
        attachment = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content)
        record = _serialise(attachment)
        offset = self._append(record)
        self._summary.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=len(record),
                create_time=0,
                log_time=0,
                data_size=len(content),
                name=name,
                media_type=media_type,
            )
        )

    def add_channel(self, topic: str, schema_name: str, schema: bytes, entries: Mapping[str, str]) -> None:
        """Appends a topic of protobuf messages; the first one's channel has the number 1, and so on.

        The entries are in the summary again, and so under its CRC.
        """
        number = len(self._summary.channels) + 1
        of_messages = Schema(id=number, name=schema_name, encoding="protobuf", data=schema)
        channel = Channel(id=number, topic=topic, message_encoding="protobuf", schema_id=number, metadata=dict(entries))
        self._append(_serialise(of_messages, channel))
        self._summary.schemas.append(of_messages)
        self._summary.channels.append(channel)

    def add_chunk(self, messages: Sequence[Message]) -> None:
        """Appends one or more messages as one compressed chunk with its index."""
        content, indices = _pack(messages)
        times = [message.log_time for message in messages]
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(content),
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        record = _serialise(chunk)
        offset = self._append(record + _serialise(*indices))
        self._summary.chunks.append(_chunk_index(chunk, offset, len(record), indices))
        self._summary.messages.update(message.channel_id for message in messages)

    def finish(self) -> None:
        """Completes the file with its summary; nothing can be appended afterwards."""
        data_end = _serialise(DataEnd(data_section_crc=self._crc))
        self._append(data_end + _ending(self._summary, self.size + len(data_end)))

    def close(self) -> None:
        """Closes the file as it is; a second call does nothing."""
        self._file.close()

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


def _write_at(descriptor: int, content: bytes, offset: int) -> None:
    rest = memoryview(content)
    while rest:
        written = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[written:], offset + written


def _serialise(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _pack(messages: Sequence[Message]) -> tuple[bytes, list[MessageIndex]]:
    """The content of a chunk and, for each channel, where in it its messages begin."""
    parts: list[bytes] = []
    places: dict[int, list[tuple[int, int]]] = {}
    size = 0
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


def _chunk_index(chunk: Chunk, offset: int, length: int, indices: list[MessageIndex]) -> ChunkIndex:
    lengths = [len(_serialise(index)) for index in indices]
    begins = [offset + length + sum(lengths[:position]) for position in range(len(indices))]
    return ChunkIndex(
        chunk_start_offset=offset,
        chunk_length=length,
        message_index_offsets={index.channel_id: begin for index, begin in zip(indices, begins, strict=True)},
        message_index_length=sum(lengths),
        message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        uncompressed_size=chunk.uncompressed_size,
    )


def _ending(summary: _Summary, begin: int) -> bytes:
    """The summary section, which begins at `begin`, with its offsets, the footer and the closing magic."""
    content, offsets = b"", []
    for opcode, records in summary.groups().items():
        group = _serialise(*records)
        if group:
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=begin + len(content), group_length=len(group))
            )
        content += group
    offset_start = begin + len(content)
    content += _serialise(*offsets)
    footer_start = _FOOTER_START.pack(Opcode.FOOTER, 20, begin, offset_start)
    crc = zlib.crc32(footer_start, zlib.crc32(content))
    footer = Footer(summary_start=begin, summary_offset_start=offset_start, summary_crc=crc)
    return content + _serialise(footer) + MCAP0_MAGIC
