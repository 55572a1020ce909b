"""The index of a finished MCAP file that bears none, or not a whole one: made by reading the file from begin to end.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from carrl.log.mcap_records import (
    HEAD,
    MAX_RECORD_BYTES,
    check_crc,
    message_of,
    messages_in,
    parse,
    records_in,
    unpack,
)
from carrl.log.mcap_summary import attachment_index

_STRETCH_BYTES = 2**20


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


def scan(file: BinaryIO, size: int) -> McapIndex:
    """Reads the whole file, of so many bytes, and tells what is where in it.

    Raises:
        UnsupportedError: a chunk is packed in an unknown way.
        ValueError: the file is damaged.
    """
    index = McapIndex()
    file.seek(0)
    for offset, opcode, body in verified_records(file, size):
        if opcode == Opcode.MESSAGE:
            _add_lone_message(index, offset, body)
        elif opcode == Opcode.DATA_END:
            index.data_checked = any(body)
        else:
            _add(index, offset, opcode, body)
    return index


def verified_records(file: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """Yields (offset, opcode, body) of each record of the data section; in the end both sections' CRCs are checked.

    Raises:
        ValueError: the file is damaged.
    """
    crc = zlib.crc32(file.read(len(MCAP0_MAGIC)))
    data_ended = False
    while True:
        offset = file.tell()
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head)
        if length > min(size - file.tell(), MAX_RECORD_BYTES):
            raise ValueError(f"a record of {length} bytes at {offset}")
        body = file.read(length)
        if opcode == Opcode.FOOTER:
            check_crc("the summary", body[-4:], zlib.crc32(head + body[:-4], crc))
            break
        if not data_ended:
            yield offset, opcode, body
        if opcode == Opcode.DATA_END:
            check_crc("the data section", body, crc)
            crc, data_ended = 0, True
            continue
        crc = zlib.crc32(body, zlib.crc32(head, crc))
    if not data_ended or file.read() != MCAP0_MAGIC:
        raise ValueError("the file's last records are out of order")


def _add(index: McapIndex, offset: int, opcode: int, body: bytes) -> None:
    """Notes a record that is no message."""
    length = HEAD.size + len(body)
    match record := parse(opcode, body):
        case Schema():
            index.schemas[record.id] = record
        case Channel():
            index.channels[record.id] = record
        case Attachment():
            index.attachments.append(attachment_index(record, offset, length))
        case Metadata():
            index.metadata.append(MetadataIndex(offset=offset, length=length, name=record.name))
        case Chunk():
            _add_chunk(index, offset, length, record)


def _add_chunk(index: McapIndex, offset: int, length: int, chunk: Chunk) -> None:
    content = unpack(chunk)
    for opcode, body in records_in(content):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _add(index, offset, opcode, body)
    counts = Counter(message.channel_id for message in messages_in(content))
    index.messages.update(counts)
    index.chunks.append(
        ChunkIndex(
            chunk_start_offset=offset,
            chunk_length=length,
            message_index_offsets=dict.fromkeys(counts, 0),
            message_index_length=0,
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
    )


def _add_lone_message(index: McapIndex, offset: int, body: bytes) -> None:
    """Notes a message that lies in no chunk, in the stretch that it goes on with, or in a new one."""
    length = HEAD.size + len(body)
    message = message_of(body)
    index.messages[message.channel_id] += 1
    last = index.chunks[-1] if index.chunks and index.chunks[-1].chunk_start_offset in index.stretches else None
    if last is None or last.chunk_start_offset + last.chunk_length != offset or last.chunk_length > _STRETCH_BYTES:
        index.stretches.add(offset)
        index.chunks.append(_stretch(offset, length, message))
        return
    last.chunk_length += length
    last.message_index_offsets[message.channel_id] = 0
    last.message_start_time = min(last.message_start_time, message.log_time)
    last.message_end_time = max(last.message_end_time, message.log_time)


def _stretch(offset: int, length: int, message: Message) -> ChunkIndex:
    return ChunkIndex(
        chunk_start_offset=offset,
        chunk_length=length,
        message_index_offsets={message.channel_id: 0},
        message_index_length=0,
        message_start_time=message.log_time,
        message_end_time=message.log_time,
        compression="",
        compressed_size=0,
        uncompressed_size=0,
    )


def head_at(file: BinaryIO, offset: int) -> tuple[int, int]:
    """Opcode of the record that begins there, and where the next one does.

    Raises:
        struct.error: the file ends before.
    """
    file.seek(offset)
    opcode, length = HEAD.unpack(file.read(HEAD.size))
    return opcode, offset + HEAD.size + length
