"""A finished MCAP file, opened through its summary: what is in it, and any part of it without reading the rest.

Where the summary does not tell of all that the file holds, as MCAP allows, the file is read once from begin to end.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
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
from carrl.log.mcap_records import (
    HEAD,
    MAX_RECORD_BYTES,
    UnsupportedError,
    check_crc,
    messages_in,
    parse,
    records_in,
    unpack,
)
from carrl.log.mcap_scan import McapIndex, head_at, scan

MAX_SUMMARY_BYTES = 32 * 2**20
"""The largest summary that is read: that of a log of about 200 GB."""

_FOOTER = struct.Struct("<BQQQI")
_TOLD_OF = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.METADATA)


class IndexedFile:
    """A finished file; use it in a `with` statement. Every CRC of what it reads is checked.

    Raises:
        LogError: the file is missing, or holds what is not supported.
        DamagedLogError: it is no MCAP file, unfinished or damaged.
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
        """Yields the messages of a chunk, or of a stretch without one."""
        if entry.chunk_start_offset in self.index.stretches:
            with self._naming_damage():
                self._file.seek(entry.chunk_start_offset)
                messages = list(messages_in(self._file.read(entry.chunk_length)))
            yield from messages
            return
        chunk = self._read_entry(entry.chunk_start_offset, entry.chunk_length, Opcode.CHUNK)
        assert isinstance(chunk, Chunk)
        with self._naming_damage():
            if (len(chunk.data), chunk.uncompressed_size) != (entry.compressed_size, entry.uncompressed_size):
                raise ValueError("a chunk is not of the size that its index tells of")
            messages = list(messages_in(unpack(chunk)))
        yield from messages

    def _read_entry(self, offset: int, length: int, opcode: Opcode) -> McapRecord:
        with self._naming_damage():
            if not HEAD.size <= length <= MAX_RECORD_BYTES or offset + length > self.size:
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
        if opcode != Opcode.FOOTER or length != _FOOTER.size - HEAD.size or summary_bytes < 0:
            raise ValueError("its last record is no footer")
        if begin == 0:  # no summary
            return scan(self._file, self.size)
        if summary_bytes > MAX_SUMMARY_BYTES:
            raise ValueError(f"its summary has {summary_bytes} bytes; the limit is {MAX_SUMMARY_BYTES}")
        self._file.seek(begin)
        summary = self._file.read(summary_bytes)
        check_crc("the summary", struct.pack("<I", crc), zlib.crc32(footer[:-4], zlib.crc32(summary)))
        records = [record for opcode, body in records_in(summary) if (record := parse(opcode, body))]
        index = _index_of(records)
        if _agrees(index, records) and self._tells_all(index, begin):
            return index
        return scan(self._file, self.size)

    def _tells_all(self, index: McapIndex, summary_begin: int) -> bool:
        """Whether nothing but what the index tells of lies before the summary; does not read what it does tell of."""
        ends = {entry.offset: entry.offset + entry.length for entry in index.attachments}
        ends |= {entry.offset: entry.offset + entry.length for entry in index.metadata}
        for chunk in index.chunks:
            ends[chunk.chunk_start_offset] = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
        position = len(MCAP0_MAGIC)
        while position < summary_begin:
            if position in ends:
                position = max(position + HEAD.size, ends[position])
                continue
            opcode, position = head_at(self._file, position)
            if opcode == Opcode.DATA_END:
                return True
            if opcode in _TOLD_OF:
                return False
        return False

    @contextmanager
    def _naming_damage(self) -> Iterator[None]:
        try:
            yield
        except UnsupportedError as error:
            raise unsupported(self.path, error) from error
        except (ValueError, OSError, struct.error) as error:
            raise damaged(self.path, error) from error


def _index_of(records: list[McapRecord]) -> McapIndex:
    chunks = [record for record in records if isinstance(record, ChunkIndex)]
    chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
    ends = [0, *(chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks)]
    if any(chunk.chunk_start_offset < end for chunk, end in zip(chunks, ends, strict=False)):
        raise ValueError("its index tells of chunks that overlap")
    statistics = [record for record in records if isinstance(record, Statistics)]
    return McapIndex(
        schemas={record.id: record for record in records if isinstance(record, Schema)},
        channels={record.id: record for record in records if isinstance(record, Channel)},
        chunks=chunks,
        attachments=[record for record in records if isinstance(record, AttachmentIndex)],
        metadata=[record for record in records if isinstance(record, MetadataIndex)],
        messages=Counter(statistics[0].channel_message_counts if statistics else {}),
    )


def _agrees(index: McapIndex, records: list[McapRecord]) -> bool:
    """Whether there are statistics, and as many entries of each kind as they count."""
    for record in records:
        if isinstance(record, Statistics):
            counted = (record.channel_count, record.chunk_count, record.attachment_count, record.metadata_count)
            found = tuple(map(len, (index.channels, index.chunks, index.attachments, index.metadata)))
            described = all(channel.schema_id in {0, *index.schemas} for channel in index.channels.values())
            return counted == found and described and record.message_count == index.messages.total()
    return False


def unsupported(path: Path, found: object) -> LogError:
    """The error for a file that is as MCAP allows, but not as CarRL reads it."""
    return LogError(f"log '{path}': is not supported: {found}; have the program that wrote it write it anew otherwise")


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
