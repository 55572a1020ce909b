"""A finished MCAP file, opened through its summary: what is in it, and any part of it without reading the rest."""

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

from carrl.errors import DamagedLogError, LogError
from carrl.record.mcap_records import HEAD, MAX_CHUNK_BYTES, check_crc, messages_in, parse, records_in, unpack

MAX_SUMMARY_BYTES = 32 * 2**20
"""The largest summary that is read: that of a log of about 200 GB."""

_FOOTER = struct.Struct("<BQQQI")
_MAX_ENTRY_BYTES = MAX_CHUNK_BYTES + 2**10


@dataclass(frozen=True)
class McapIndex:
    """What the summary of a file says.

    Attributes:
        channels: with their schemas, by number.
        chunks: in the order of the file.
        attachments: in the order of the file.
        metadata: in the order of the file.
        messages: how many there are, by channel.
    """

    channels: dict[int, tuple[Channel, Schema | None]]
    chunks: list[ChunkIndex]
    attachments: list[AttachmentIndex]
    metadata: list[MetadataIndex]
    messages: dict[int, int]


class IndexedFile:
    """A finished file; use it in a `with` statement. Every CRC of what it reads is checked.

    Raises:
        LogError: the file is missing, no MCAP file, unfinished or damaged.
    """

    def __init__(self, path: Path) -> None:
        """Reads the summary."""
        self.path = path
        self._file, self.size = open_log(path)
        try:
            check_magic(path, self._file, self.size)
            with self._naming_damage():
                self.index = self._read_index()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        """Returns the file itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes the file."""
        self._file.close()

    def read_metadata(self, entry: MetadataIndex) -> Metadata:
        """A metadata record; MCAP keeps no CRC of it."""
        record = self._read_entry(entry.offset, entry.length, Opcode.METADATA)
        assert isinstance(record, Metadata)
        return record

    def read_attachment(self, entry: AttachmentIndex) -> Attachment:
        """An attachment with its content."""
        record = self._read_entry(entry.offset, entry.length, Opcode.ATTACHMENT)
        assert isinstance(record, Attachment)
        return record

    def messages(self, entry: ChunkIndex) -> Iterator[Message]:
        """Yields the messages of a chunk."""
        chunk = self._read_entry(entry.chunk_start_offset, entry.chunk_length, Opcode.CHUNK)
        assert isinstance(chunk, Chunk)
        with self._naming_damage():
            if (len(chunk.data), chunk.uncompressed_size) != (entry.compressed_size, entry.uncompressed_size):
                raise ValueError("a chunk is not of the size that its index tells of")
            messages = list(messages_in(unpack(chunk)))
        yield from messages

    def _read_entry(self, offset: int, length: int, opcode: Opcode) -> McapRecord:
        with self._naming_damage():
            if not HEAD.size <= length <= _MAX_ENTRY_BYTES or offset + length > self.size:
                raise ValueError(f"its index tells of a record of {length} bytes at {offset}")
            self._file.seek(offset)
            content = self._file.read(length)
            if HEAD.unpack_from(content) != (opcode, length - HEAD.size):
                raise ValueError(f"no {opcode.name.lower()} where its index tells of one")
            record = parse(opcode, content[HEAD.size :])
            assert record is not None
            return record

    def _read_index(self) -> McapIndex:
        self._file.seek(self.size - len(MCAP0_MAGIC) - _FOOTER.size)
        footer = self._file.read(_FOOTER.size)
        opcode, length, begin, _, crc = _FOOTER.unpack(footer)
        summary_bytes = self.size - len(MCAP0_MAGIC) - _FOOTER.size - begin
        if opcode != Opcode.FOOTER or length != _FOOTER.size - HEAD.size or begin == 0 or summary_bytes < 0:
            raise ValueError("its last record is no footer with a summary")
        if summary_bytes > MAX_SUMMARY_BYTES:
            raise ValueError(f"its summary has {summary_bytes} bytes; the limit is {MAX_SUMMARY_BYTES}")
        self._file.seek(begin)
        summary = self._file.read(summary_bytes)
        check_crc("the summary", struct.pack("<I", crc), zlib.crc32(footer[:-4], zlib.crc32(summary)))
        return _index_of([record for opcode, body in records_in(summary) if (record := parse(opcode, body))])

    @contextmanager
    def _naming_damage(self) -> Iterator[None]:
        try:
            yield
        except (ValueError, OSError, struct.error) as error:
            raise damaged(self.path, error) from error


def _index_of(records: list[McapRecord]) -> McapIndex:
    schemas = {record.id: record for record in records if isinstance(record, Schema)}
    channels = [record for record in records if isinstance(record, Channel)]
    chunks = [record for record in records if isinstance(record, ChunkIndex)]
    ends = [0, *(chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks)]
    if any(chunk.chunk_start_offset < end for chunk, end in zip(chunks, ends, strict=False)):
        raise ValueError("its index tells of chunks that overlap")
    statistics = [record for record in records if isinstance(record, Statistics)]
    return McapIndex(
        channels={channel.id: (channel, schemas.get(channel.schema_id)) for channel in channels},
        chunks=chunks,
        attachments=[record for record in records if isinstance(record, AttachmentIndex)],
        metadata=[record for record in records if isinstance(record, MetadataIndex)],
        messages=statistics[0].channel_message_counts if statistics else {},
    )


def damaged(path: Path, found: object) -> DamagedLogError:
    """The error for a file in which something is not as it was written."""
    return DamagedLogError(f"log '{path}': is damaged: {found}; salvage it with: carrl log recover IN OUT")


def open_log(path: Path) -> tuple[BufferedReader, int]:
    """Opens a file of at least one byte, and tells its size.

    Raises:
        LogError: there is none.
        DamagedLogError: it is empty.
    """
    try:
        if path.is_dir():
            raise LogError(f"log '{path}': is a folder; give a file, such as {path / 'train.mcap'}")
        size = path.stat().st_size
        if not path.is_file():  # a pipe or a device would block, or never end
            raise LogError(f"log '{path}': is not a regular file; give the path of a log")
        if size == 0:
            raise DamagedLogError(f"log '{path}': is empty, 0 bytes; give the path of a log")
        return path.open("rb"), size
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise LogError(f"log '{path}': cannot be read: {reason}; give the path of a log") from error


def check_magic(path: Path, file: BufferedReader, size: int) -> None:
    """Checks what an MCAP file begins and ends with, and goes back to its begin.

    Raises:
        DamagedLogError: this is no MCAP file, or an unfinished one.
    """
    start = file.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC[: len(start)]:
        raise DamagedLogError(f"log '{path}': is not an MCAP file, it starts with {start!r}; give the path of a log")
    file.seek(max(0, size - len(MCAP0_MAGIC)))
    if size < 2 * len(MCAP0_MAGIC) + _FOOTER.size or file.read() != MCAP0_MAGIC:
        raise DamagedLogError(
            f"log '{path}': is unfinished, {size} bytes without the mark that ends an MCAP file; "
            "wait for the run to end, or salvage it with: carrl log recover IN OUT"
        )
    file.seek(0, os.SEEK_SET)
