"""An MCAP file, opened through its summary: what is in it, and any part of it without reading the rest.

Where the summary does not tell of all that the file holds, as MCAP allows, the file is read once from begin to end; so
is one that a process is writing, up to where that has come.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import fcntl
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
    Content,
    McapIndex,
    UnsupportedError,
    check_crc,
    message_of,
    messages_in,
    parse,
    records,
    records_in,
    unpack,
)

MAX_SUMMARY_BYTES = 32 * 2**20
"""The largest summary that is read: that of a log of about 200 GB."""

_FOOTER = struct.Struct("<BQQQI")
_TOLD_OF = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.METADATA)
_STRETCH_BYTES = 2**20


class FileContent:
    """The bytes of an open file, of which only those asked for are read."""

    def __init__(self, file: BufferedReader, size: int) -> None:
        self._descriptor, self._size = file.fileno(), size

    def __len__(self) -> int:
        """Size of the file when it was opened."""
        return self._size

    def __getitem__(self, part: slice, /) -> bytes:
        """Some of them; fewer than asked for where the file has become shorter."""
        begin, end, _ = part.indices(self._size)
        return os.pread(self._descriptor, max(0, end - begin), begin)


class IndexedFile:
    """A file that is finished, or being written; use it in a `with` statement. Every CRC of what it reads is checked.

    Attributes:
        grows: whether it is being written; what came after it was opened is not seen.

    Raises:
        LogError: the file is missing, or holds what is not supported.
        DamagedLogError: it is no MCAP file, damaged, or unfinished although nobody writes it any more.
    """

    def __init__(self, path: Path) -> None:
        """Reads the summary."""
        self.path = path
        self._file, self.size = open_log(path)
        try:
            self._content = FileContent(self._file, self.size)
            self.grows = _is_being_written(self._file, self._content)
            if not self.grows:
                check_magic(path, self._content)
            with naming_damage(path):
                self.index = _scan_growing(self._content) if self.grows else self._read_index()
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

    @property
    def places(self) -> dict[int, list[int]]:
        """Where the chunks, attachments and metadata records begin, by opcode, bytes from the file's begin."""
        chunks = [chunk.chunk_start_offset for chunk in self.index.chunks]
        return {
            Opcode.CHUNK: [place for place in chunks if place not in self.index.stretches],
            Opcode.ATTACHMENT: [entry.offset for entry in self.index.attachments],
            Opcode.METADATA: [entry.offset for entry in self.index.metadata],
        }

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
        begin = entry.chunk_start_offset
        if begin in self.index.stretches:
            with naming_damage(self.path):
                messages = list(messages_in(self._content[begin : begin + entry.chunk_length]))
            yield from messages
            return
        chunk = self._read_entry(begin, entry.chunk_length, Opcode.CHUNK)
        assert isinstance(chunk, Chunk)
        with naming_damage(self.path):
            if (len(chunk.data), chunk.uncompressed_size) != (entry.compressed_size, entry.uncompressed_size):
                raise ValueError("a chunk is not of the size that its index tells of")
            messages = list(messages_in(unpack(chunk)))
        yield from messages

    def _read_entry(self, offset: int, length: int, opcode: Opcode) -> McapRecord:
        with naming_damage(self.path):
            if not HEAD.size <= length <= MAX_RECORD_BYTES or offset + length > self.size:
                raise ValueError(f"its index tells of a record of {length} bytes at {offset}")
            content = self._content[offset : offset + length]
            if HEAD.unpack_from(content) != (opcode, length - HEAD.size):
                raise ValueError(f"no {opcode.name.lower()} where its index tells of one")
            record = parse(opcode, content[HEAD.size :])
            assert record is not None
            return record

    def _read_index(self) -> McapIndex:
        end = self.size - len(MCAP0_MAGIC) - _FOOTER.size
        footer = self._content[end : end + _FOOTER.size]
        opcode, length, begin, _, crc = _FOOTER.unpack(footer)
        if opcode != Opcode.FOOTER or length != _FOOTER.size - HEAD.size or begin > end:
            raise ValueError("its last record is no footer")
        if begin == 0:  # no summary
            return scan(self._content)
        if end - begin > MAX_SUMMARY_BYTES:
            raise ValueError(f"its summary has {end - begin} bytes; the limit is {MAX_SUMMARY_BYTES}")
        summary = self._content[begin:end]
        check_crc("the summary", struct.pack("<I", crc), zlib.crc32(footer[:-4], zlib.crc32(summary)))
        found = [record for opcode, body in records_in(summary) if (record := parse(opcode, body))]
        index = _index_of(found)
        return index if _agrees(index, found) and self._tells_all(index, begin) else scan(self._content)

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
            opcode, _, position = next(records(self._content, position, self.size))
            if opcode == Opcode.DATA_END:
                return True
            if opcode in _TOLD_OF:
                return False
        return False


def _index_of(found: list[McapRecord]) -> McapIndex:
    chunks = sorted(
        (each for each in found if isinstance(each, ChunkIndex)), key=lambda chunk: chunk.chunk_start_offset
    )
    ends = [0, *(chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks)]
    if any(chunk.chunk_start_offset < end for chunk, end in zip(chunks, ends, strict=False)):
        raise ValueError("its index tells of chunks that overlap")
    statistics = [record for record in found if isinstance(record, Statistics)]
    return McapIndex(
        schemas={record.id: record for record in found if isinstance(record, Schema)},
        channels={record.id: record for record in found if isinstance(record, Channel)},
        chunks=chunks,
        attachments=[record for record in found if isinstance(record, AttachmentIndex)],
        metadata=[record for record in found if isinstance(record, MetadataIndex)],
        messages=Counter(statistics[0].channel_message_counts if statistics else {}),
    )


def _agrees(index: McapIndex, found: list[McapRecord]) -> bool:
    """Whether there are statistics, and as many entries of each kind as they count."""
    for record in found:
        if isinstance(record, Statistics):
            counted = (record.channel_count, record.chunk_count, record.attachment_count, record.metadata_count)
            own = tuple(map(len, (index.channels, index.chunks, index.attachments, index.metadata)))
            described = all(channel.schema_id in {0, *index.schemas} for channel in index.channels.values())
            return counted == own and described and record.message_count == index.messages.total()
    return False


def scan(content: Content) -> McapIndex:
    """Reads a whole file and tells what is where in it.

    Raises:
        UnsupportedError: a chunk is packed in an unknown way.
        ValueError: the file is damaged.
    """
    index = McapIndex()
    for offset, opcode, body in verified_records(content):
        _add_record(index, offset, opcode, body)
    return index


def _scan_growing(content: Content) -> McapIndex:
    """The same of a file that is being written, as far as its records are whole."""
    index, begin = McapIndex(), len(MCAP0_MAGIC)
    while begin + HEAD.size <= len(content):
        opcode, length = HEAD.unpack(content[begin : begin + HEAD.size])
        end = begin + HEAD.size + length
        if end > len(content) or opcode == Opcode.DATA_END:
            break
        _add_record(index, begin, opcode, content[begin + HEAD.size : end])
        begin = end
    return index


def _add_record(index: McapIndex, offset: int, opcode: int, body: bytes) -> None:
    length = HEAD.size + len(body)
    if opcode == Opcode.MESSAGE:
        _add_lone_message(index, offset, length, message_of(body))
    elif opcode == Opcode.DATA_END:
        index.data_checked = any(body)
    elif opcode == Opcode.CHUNK:
        chunk = parse(opcode, body)
        assert isinstance(chunk, Chunk)
        _add_chunk(index, chunk, offset, length)
    else:
        index.add(parse(opcode, body), offset, length)


def verified_records(content: Content) -> Iterator[tuple[int, int, bytes]]:
    """Yields (offset, opcode, body) of each record of the data section; in the end both sections' CRCs are checked.

    Raises:
        ValueError: the file is damaged.
    """
    crc, data_ended, last = zlib.crc32(content[: len(MCAP0_MAGIC)]), False, False
    for opcode, begin, end in records(content, len(MCAP0_MAGIC), len(content) - len(MCAP0_MAGIC)):
        if end - begin > MAX_RECORD_BYTES or last:
            raise ValueError(f"a record of {end - begin} bytes at {begin - HEAD.size}")
        head, body = content[begin - HEAD.size : begin], content[begin:end]
        if opcode == Opcode.FOOTER:
            check_crc("the summary", body[-4:], zlib.crc32(head + body[:-4], crc))
            last = True
            continue
        if not data_ended:
            yield begin - HEAD.size, opcode, body
        if opcode == Opcode.DATA_END:
            check_crc("the data section", body, crc)
            crc, data_ended = 0, True
            continue
        crc = zlib.crc32(body, zlib.crc32(head, crc))
    if not (data_ended and last):
        raise ValueError("the file's last records are out of order")


def _add_chunk(index: McapIndex, chunk: Chunk, offset: int, length: int) -> None:
    content = unpack(chunk)
    for opcode, body in records_in(content):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            index.add(parse(opcode, body), offset, length)
    index.add_chunk(chunk, offset, length)
    for channel, count in Counter(message.channel_id for message in messages_in(content)).items():
        index.add_messages(channel, count)


def _add_lone_message(index: McapIndex, offset: int, length: int, message: Message) -> None:
    """Notes a message that lies in no chunk, in the stretch that it goes on with, or in a new one."""
    last = index.chunks[-1] if index.chunks and index.chunks[-1].chunk_start_offset in index.stretches else None
    if last is None or last.chunk_start_offset + last.chunk_length != offset or last.chunk_length > _STRETCH_BYTES:
        index.stretches.add(offset)
        index.add_chunk(Chunk("", b"", message.log_time, message.log_time, 0, 0), offset, 0)
        last = index.chunks[-1]
    index.add_messages(message.channel_id, 1)
    last.chunk_length += length
    last.message_start_time = min(last.message_start_time, message.log_time)
    last.message_end_time = max(last.message_end_time, message.log_time)


@contextmanager
def naming_damage(path: Path) -> Iterator[None]:
    """Turns what reading a damaged file raises into one sentence."""
    try:
        yield
    except UnsupportedError as error:
        raise LogError(
            f"log '{path}': is not supported: {error}; have the program that wrote it write it anew otherwise"
        ) from error
    except (ValueError, OSError, struct.error) as error:
        raise damaged(path, error) from error


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


def _is_being_written(file: BufferedReader, content: Content) -> bool:
    """Whether an unfinished MCAP file is locked by whoever writes it."""
    if content[: len(MCAP0_MAGIC)] != MCAP0_MAGIC or _is_finished(content):
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


def _is_finished(content: Content) -> bool:
    size = len(content)
    return size >= 2 * len(MCAP0_MAGIC) + _FOOTER.size and content[size - len(MCAP0_MAGIC) :] == MCAP0_MAGIC


def check_magic(path: Path, content: Content) -> None:
    """Checks what an MCAP file begins and ends with.

    Raises:
        DamagedLogError: this is no MCAP file, or an unfinished one.
    """
    size, start = len(content), content[: len(MCAP0_MAGIC)]
    if start != MCAP0_MAGIC[: len(start)]:
        raise DamagedLogError(f"log '{path}': is not an MCAP file, it starts with {start!r}; give the path of a log")
    if not _is_finished(content):
        raise DamagedLogError(
            f"log '{path}': is unfinished, {size} bytes without the mark that ends an MCAP file; "
            "wait for the run to end, or salvage it with: carrl log recover IN OUT"
        )
