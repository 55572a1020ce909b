"""MCAP records from bytes that nobody vouches for, and the index of what is where in a file.

Whatever is wrong with a record comes out as one ValueError.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Protocol

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

MAX_CHUNK_BYTES = 64 * 2**20
"""The largest chunk that is unpacked; the writer's stay below 1 + 8 MiB."""

MAX_RECORD_BYTES = MAX_CHUNK_BYTES + 2**10
"""The largest record that is read."""

HEAD = struct.Struct("<BQ")
"""What every record begins with: its opcode and the length of its body."""

_MESSAGE_FIELDS = struct.Struct("<HIQQ")
_KINDS = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}


class Content(Protocol):
    """Bytes to read from: those of a chunk, or of a file."""

    def __len__(self) -> int:
        """How many there are."""

    def __getitem__(self, part: slice, /) -> bytes:
        """Some of them."""


class UnsupportedError(ValueError):
    """What MCAP allows and CarRL does not read."""


def parse(opcode: int, body: bytes) -> McapRecord | None:
    """The record, an attachment's own CRC checked; None if it is of a kind that a log's reader does without.

    Raises:
        ValueError: the body is not that of such a record.
    """
    kind = _KINDS.get(opcode)  # type: ignore[call-overload]  # an opcode is any number here
    if kind is None:
        return None
    if kind is Attachment:
        check_crc("an attachment", body[-4:], zlib.crc32(body[:-4]))
    try:
        record: McapRecord = kind.read(ReadDataStream(BytesIO(body)))
    except Exception as error:  # mcap's parsers raise whatever the bytes lead them to
        raise ValueError(f"a record of kind {kind.__name__} cannot be read") from error
    return record


def records(content: Content, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yields the records that lie from one byte to another: opcode, and where the body begins and ends.

    Raises:
        ValueError: a record does not fit.
    """
    while begin < end:
        if begin + HEAD.size > end:
            raise ValueError(f"{end - begin} bytes after the last record")
        opcode, length = HEAD.unpack(content[begin : begin + HEAD.size])
        begin += HEAD.size
        if length > end - begin:
            raise ValueError(f"a record of {length} bytes does not fit")
        yield opcode, begin, begin + length
        begin += length


def length_at(content: Content, position: int) -> int:
    """How many bytes the body of a record that may begin there may have at most, whatever it says itself."""
    _, length = HEAD.unpack(content[position : position + HEAD.size])
    return min(int(length), MAX_RECORD_BYTES, len(content) - position - HEAD.size)


def records_in(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yields (opcode, body) of each record in a chunk or a summary.

    Raises:
        ValueError: a record does not fit.
    """
    return ((opcode, content[begin:end]) for opcode, begin, end in records(content, 0, len(content)))


def unpack(chunk: Chunk) -> bytes:
    """What a chunk holds, its CRC checked.

    Raises:
        UnsupportedError: it is packed in another way than with zstd or LZ4, or too large.
        ValueError: it is damaged.
    """
    unpacked_bytes(chunk)
    content = _DECOMPRESSORS[chunk.compression](chunk)
    check_crc("a chunk", struct.pack("<I", chunk.uncompressed_crc), zlib.crc32(content))
    return content


def unpacked_bytes(chunk: Chunk) -> int:
    """How many bytes a chunk holds at most.

    Raises:
        UnsupportedError: it is packed in another way than with zstd or LZ4, or too large.
        ValueError: it is damaged.
    """
    if chunk.compression not in _DECOMPRESSORS:
        raise UnsupportedError(f"a chunk is packed with {chunk.compression!r:.20}; zstd, lz4 or nothing can be read")
    sizes = [chunk.uncompressed_size]
    if chunk.compression == "zstd":
        sizes.append(_frame_size(chunk.data))  # -1: not stored, then the size above is the limit
    if max(sizes) > MAX_CHUNK_BYTES:
        raise UnsupportedError(f"a chunk claims {max(sizes)} bytes; the limit is {MAX_CHUNK_BYTES}")
    return max(sizes)


def messages_in(content: bytes) -> Iterator[Message]:
    """The messages of an unpacked chunk, one after the other.

    Raises:
        ValueError: a record does not fit.
    """
    return (message_of(body) for opcode, body in records_in(content) if opcode == Opcode.MESSAGE)


def message_of(body: bytes) -> Message:
    """The message whose record has this body.

    Raises:
        ValueError: the body is too short.
    """
    if len(body) < _MESSAGE_FIELDS.size:
        raise ValueError(f"a message of {len(body)} bytes")
    channel_id, sequence, log_time, publish_time = _MESSAGE_FIELDS.unpack_from(body)
    return Message(
        channel_id=channel_id,
        sequence=sequence,
        log_time=log_time,
        publish_time=publish_time,
        data=body[_MESSAGE_FIELDS.size :],
    )


def check_crc(what: str, stored: bytes, computed: int) -> None:
    """Raises a ValueError where a stored CRC is another than the computed one; 0 stands for none."""
    if len(stored) != 4:
        raise ValueError(f"{what} has no CRC")
    [expected] = struct.unpack("<I", stored)
    if expected not in (0, computed):
        raise ValueError(f"{what} has CRC {computed:#010x}, but {expected:#010x} was stored")


def _frame_size(data: bytes) -> int:
    try:
        return zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise ValueError("a chunk is not what zstd writes") from error


def _unpack_zstd(chunk: Chunk) -> bytes:
    try:
        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    except zstandard.ZstdError as error:
        raise ValueError("a chunk cannot be unpacked") from error


def _unpack_lz4(chunk: Chunk) -> bytes:
    """No more than the chunk claims, for a few bytes may unpack to gigabytes."""
    try:
        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size + 1)
    except (RuntimeError, EOFError) as error:
        raise ValueError("a chunk cannot be unpacked") from error
    if len(content) != chunk.uncompressed_size:
        raise ValueError("a chunk does not unpack to as many bytes as it claims")
    return bytes(content)


_DECOMPRESSORS: dict[str, Callable[[Chunk], bytes]] = {
    "": lambda chunk: chunk.data,
    "zstd": _unpack_zstd,
    "lz4": _unpack_lz4,
}


@dataclass
class McapIndex:
    """What is where in a file.

    Attributes:
        schemas: by number.
        channels: by number.
        chunks: in the order of the file; also the stretches of messages that lie in no chunk, as if each were one.
            One that does not say which channels it holds may hold any.
        attachments: in the order of the file.
        metadata: in the order of the file.
        messages: how many there are, by channel.
        stretches: where the stretches without a chunk begin.
        data_checked: whether the whole data section was compared with a checksum.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    messages: Counter[int] = field(default_factory=Counter)
    stretches: set[int] = field(default_factory=set)
    data_checked: bool = False

    def add(self, record: McapRecord | None, offset: int, length: int) -> None:
        """Notes a record that is neither chunk nor message, of so many bytes from the offset on."""
        match record:
            case Schema():
                self.schemas[record.id] = record
            case Channel():
                self.channels[record.id] = record
            case Metadata():
                self.metadata.append(MetadataIndex(offset=offset, length=length, name=record.name))
            case Attachment():
                self.attachments.append(
                    AttachmentIndex(
                        offset=offset,
                        length=length,
                        create_time=record.create_time,
                        log_time=record.log_time,
                        data_size=len(record.data),
                        name=record.name,
                        media_type=record.media_type,
                    )
                )

    def add_chunk(self, chunk: Chunk, offset: int, length: int) -> None:
        """Notes a chunk, of so many bytes from the offset on; `add_messages` says what is in it."""
        self.chunks.append(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=length,
                message_index_offsets={},
                message_index_length=0,
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def add_messages(self, channel: int, count: int, index_offset: int = 0, index_length: int = 0) -> None:
        """Notes messages of the last chunk, and where their own index is, if they have one."""
        self.messages[channel] += count
        self.chunks[-1].message_index_offsets[channel] = index_offset
        self.chunks[-1].message_index_length += index_length
