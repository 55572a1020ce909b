"""Reads the records of a finished MCAP file and vouches for them: every byte is under a CRC that was checked.

The `mcap` package's own readers check fewer CRCs (not those of the summary and of attachments) and parse index
records of any length; this one reads a record only when it fits the file, and only the kinds a log is made of.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from io import BufferedReader, BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from carrl.errors import LogError

MAX_CHUNK_BYTES = 64 * 2**20
"""The largest chunk that is unpacked; the writer's stay below 1 + 8 MiB."""

_HEAD = struct.Struct("<BQ")


def intact_records(path: Path) -> Iterator[McapRecord]:
    """Yields schemas, channels, messages, metadata and attachments in file order, unpacking chunks one at a time.

    A record is yielded once its own CRC is checked; that the file as a whole is intact is known when the last one
    has been yielded.

    Raises:
        LogError: the file is missing, no MCAP file, unfinished or damaged.
    """
    try:
        size = _size_of_file(path)
        file = path.open("rb")
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise LogError(f"log '{path}': cannot be read: {reason}; give the path of a log") from error
    with file:
        _check_magic(path, file, size)
        try:
            for opcode, body in _verified_records(file, size):
                yield from _parse(opcode, body)
        except Exception as error:  # mcap's parsers raise whatever the damaged bytes lead them to
            raise LogError(
                f"log '{path}': damaged at or before byte {file.tell()}: {str(error) or type(error).__name__}; "
                "copy the file again, or repeat the run"
            ) from error


def _size_of_file(path: Path) -> int:
    if path.is_dir():
        raise LogError(f"log '{path}': is a folder; give a file, such as {path / 'train.mcap'}")
    size = path.stat().st_size
    if not path.is_file():  # a pipe or a device would block, or never end
        raise LogError(f"log '{path}': is not a regular file; give the path of a log")
    if size == 0:
        raise LogError(f"log '{path}': is empty, 0 bytes; give the path of a log")
    return size


def _check_magic(path: Path, file: BufferedReader, size: int) -> None:
    start = file.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC[: len(start)]:
        raise LogError(f"log '{path}': is not an MCAP file, it starts with {start!r}; give the path of a log")
    file.seek(max(0, size - len(MCAP0_MAGIC)))
    if size < 2 * len(MCAP0_MAGIC) or file.read() != MCAP0_MAGIC:
        raise LogError(
            f"log '{path}': is unfinished, {size} bytes without the mark that ends an MCAP file; "
            "wait for the run to end, or repeat it if it was killed"
        )
    file.seek(0, os.SEEK_SET)


def _verified_records(file: BufferedReader, size: int) -> Iterator[tuple[int, bytes]]:
    """Yields (opcode, body) of each record and checks the CRCs of the two sections as it passes their ends."""
    crc = zlib.crc32(file.read(len(MCAP0_MAGIC)))
    data_ended = False
    while True:
        head = file.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head)
        if length > size - file.tell():
            raise ValueError(f"a record of {length} bytes does not fit the file")
        body = file.read(length)
        if opcode == Opcode.FOOTER:
            _check_crc("summary section", body[-4:], zlib.crc32(head + body[:-4], crc))
            break
        if opcode == Opcode.DATA_END:
            _check_crc("data section", body, crc)
            crc, data_ended = 0, True
            continue
        crc = zlib.crc32(body, zlib.crc32(head, crc))
        yield opcode, body
    if not data_ended or file.read() != MCAP0_MAGIC:
        raise ValueError("the file's last records are out of order")


def _check_crc(what: str, stored: bytes, computed: int) -> None:
    [expected] = struct.unpack("<I", stored)
    if expected not in (0, computed):  # 0: the writer, not ours, kept none
        raise ValueError(f"the {what} has CRC {computed:#010x}, but {expected:#010x} was stored")


def _parse(opcode: int, body: bytes) -> list[McapRecord]:
    stream = ReadDataStream(BytesIO(body))
    match opcode:
        case Opcode.CHUNK:
            return _unpack(Chunk.read(stream))
        case Opcode.MESSAGE:
            return [Message.read(stream, len(body))]
        case Opcode.ATTACHMENT:
            _check_crc("attachment", body[-4:], zlib.crc32(body[:-4]))
            return [Attachment.read(stream)]
        case Opcode.SCHEMA:
            return [Schema.read(stream)]
        case Opcode.CHANNEL:
            return [Channel.read(stream)]
        case Opcode.METADATA:
            return [Metadata.read(stream)]
    return []


def _unpack(chunk: Chunk) -> list[McapRecord]:
    if chunk.compression not in ("", "zstd"):
        raise ValueError(f"a chunk is packed with {chunk.compression!r}; only zstd or nothing can be read")
    sizes = [chunk.uncompressed_size]
    if chunk.compression == "zstd":
        sizes.append(zstandard.frame_content_size(chunk.data))  # -1: not stored, then the size above is the limit
    if max(sizes) > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk claims {max(sizes)} bytes; the limit is {MAX_CHUNK_BYTES}")
    return breakup_chunk(chunk, validate_crc=True)
