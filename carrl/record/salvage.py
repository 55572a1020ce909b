"""Finds the records of a damaged MCAP file that can still be vouched for.

A record is looked for at every byte, for a damaged length leads nowhere; what bears a checksum that fits is intact.
"""

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, McapRecord, Metadata

from carrl.record.mcap_records import HEAD, MAX_CHUNK_BYTES, unpack
from carrl.record.metadata import is_intact
from carrl.record.schema import METADATA_NAME

Content = mmap.mmap
"""A file's bytes, of which those looked at are in memory."""

_CANDIDATE = re.compile(rb"[\x06\x09\x0c].{4}\x00{4}", re.DOTALL)
"""Opcode and length of what may be a chunk, an attachment or a metadata record of less than 4 GiB."""
_KINDS: dict[int, type[Attachment] | type[Chunk] | type[Metadata]] = {
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}
_MAX_RECORD_BYTES = MAX_CHUNK_BYTES + 2**10
_VAIN_BYTES = 2**30
"""How many bytes are examined in vain, beside eight times the file's, before the search ends.

A file may be made so that every byte of it looks like the begin of a record.
"""


def intact_records(content: Content) -> Iterator[tuple[int, McapRecord]]:
    """Yields (position, record) of every intact chunk, attachment and metadata record of a log, in the file's order."""
    position, patience = 0, 8 * len(content) + _VAIN_BYTES
    while patience > 0 and (candidate := _CANDIDATE.search(content, position)):
        position = candidate.start()
        try:
            record, end = record_at(content, position)
        except ValueError:
            patience -= _length_at(content, position) + MAX_CHUNK_BYTES // 2**8
            position += 1
        else:
            yield position, record
            position = end


def record_at(content: Content, position: int) -> tuple[McapRecord, int]:
    """The intact record that begins at this byte, and where it ends, whatever its own length says.

    Raises:
        ValueError: there is none.
    """
    opcode, _ = HEAD.unpack_from(content, position)
    begin = position + HEAD.size
    stream = ReadDataStream(BytesIO(content[begin : begin + _length_at(content, position)]))
    try:
        record = _KINDS[opcode].read(stream)
    except Exception as error:  # mcap's parsers raise whatever the bytes lead them to
        raise ValueError("not a record") from error
    end = begin + stream.count
    if not _is_intact(record, content[begin:end]):
        raise ValueError("a checksum does not fit")
    return record, end


def _length_at(content: Content, position: int) -> int:
    """How many bytes the body of the record there may have."""
    _, length = HEAD.unpack_from(content, position)
    return min(length, _MAX_RECORD_BYTES, len(content) - position - HEAD.size)


def _is_intact(record: McapRecord, body: bytes) -> bool:
    match record:
        case Chunk():
            return zlib.crc32(unpack(record)) == record.uncompressed_crc
        case Attachment():
            return body[-4:] == struct.pack("<I", zlib.crc32(body[:-4]))
        case Metadata():
            return record.name == METADATA_NAME and is_intact(record.metadata)
    return False
