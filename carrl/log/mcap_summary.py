"""The end of an MCAP file, which tells of the rest of it: kept while the file is written, or read back from it.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from mmap import mmap

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from carrl.log.mcap_records import HEAD, parse

_FOOTER_START = struct.Struct("<BQQQ")


@dataclass
class Summary:
    """What the end of the file tells of the rest of it."""

    schemas: list[McapRecord] = field(default_factory=list)
    channels: list[McapRecord] = field(default_factory=list)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[McapRecord] = field(default_factory=list)
    metadata: list[McapRecord] = field(default_factory=list)
    messages: Counter[int] = field(default_factory=Counter)

    def add(self, record: McapRecord, offset: int, length: int, indices: Sequence[MessageIndex] = ()) -> None:
        """Notes a record of the data section.

        Args:
            record: that was written.
            offset: of its first byte in the file.
            length: in bytes, opcode and length included.
            indices: of a chunk, the records that follow it.
        """
        match record:
            case Metadata():
                self.metadata.append(MetadataIndex(offset=offset, length=length, name=record.name))
            case Attachment():
                self.attachments.append(attachment_index(record, offset, length))
            case Schema():
                self.schemas.append(record)
            case Channel():
                self.channels.append(record)
            case Chunk():
                self.chunks.append(_chunk_index(record, offset, length, indices))
                self.messages.update({index.channel_id: len(index.records) for index in indices})

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

    def ending(self, begin: int) -> bytes:
        """The summary section, which begins at `begin`, with its offsets, the footer and the closing magic."""
        content, offsets = b"", []
        for opcode, records in self.groups().items():
            group = serialise(*records)
            if group:
                offsets.append(
                    SummaryOffset(group_opcode=opcode, group_start=begin + len(content), group_length=len(group))
                )
            content += group
        offset_start = begin + len(content)
        content += serialise(*offsets)
        footer_start = _FOOTER_START.pack(Opcode.FOOTER, 20, begin, offset_start)
        crc = zlib.crc32(footer_start, zlib.crc32(content))
        footer = Footer(summary_start=begin, summary_offset_start=offset_start, summary_crc=crc)
        return content + serialise(footer) + MCAP0_MAGIC


def serialise(*records: McapRecord) -> bytes:
    """The records as bytes, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def read_back(content: mmap, size: int) -> Summary:
    """The summary of an unfinished file's records up to `size` bytes.

    Raises:
        ValueError: these are not whole records.
    """
    summary, position = Summary(), len(MCAP0_MAGIC)
    while position < size:
        record, end = _record_at(content, position, size)
        following = end
        indices: list[MessageIndex] = []
        if isinstance(record, Chunk):
            following, indices = _indices_at(content, end, size)
        if record is not None:
            summary.add(record, position, end - position, indices)
        position = following
    return summary


def _record_at(content: mmap, position: int, size: int) -> tuple[McapRecord | None, int]:
    """The record that begins there, None if the summary does not tell of its kind, and where it ends."""
    opcode, begin, end = _head_at(content, position, size)
    return parse(opcode, content[begin:end]), end


def _indices_at(content: mmap, position: int, size: int) -> tuple[int, list[MessageIndex]]:
    """The message indices that begin there, and where they end."""
    indices: list[MessageIndex] = []
    while position < size:
        opcode, begin, end = _head_at(content, position, size)
        if opcode != Opcode.MESSAGE_INDEX:
            break
        indices.append(MessageIndex.read(ReadDataStream(BytesIO(content[begin:end]))))
        position = end
    return position, indices


def _head_at(content: mmap, position: int, size: int) -> tuple[int, int, int]:
    """A record's opcode, and where its body begins and ends."""
    if position + HEAD.size > size:
        raise ValueError(f"{size - position} bytes after the last record")
    opcode, length = HEAD.unpack_from(content, position)
    begin = position + HEAD.size
    if length > size - begin:
        raise ValueError(f"a record of {length} bytes does not fit")
    return opcode, begin, begin + length


def attachment_index(attachment: Attachment, offset: int, length: int) -> AttachmentIndex:
    """What the summary tells of an attachment that is written in so many bytes from this offset on."""
    return AttachmentIndex(
        offset=offset,
        length=length,
        create_time=attachment.create_time,
        log_time=attachment.log_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def _chunk_index(chunk: Chunk, offset: int, length: int, indices: Sequence[MessageIndex]) -> ChunkIndex:
    lengths = [len(serialise(index)) for index in indices]
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
