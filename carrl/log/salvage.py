"""Finds the pieces of a damaged log that can still be vouched for, and the messages in them.

A record is looked for at every byte, for a damaged length leads nowhere; what bears a checksum that fits is intact.
Messages are told apart by what the channel records say, in the file or in their own chunk, and by what they say
themselves.
"""

import mmap
import re
import struct
import zlib
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, McapRecord, Metadata
from mcap.writer import MCAP0_MAGIC

from carrl.log.log_file import ATTACHMENT, Channels, content_checksum, is_intact
from carrl.log.mcap_records import (
    HEAD,
    McapIndex,
    length_at,
    records,
    unpack,
    unpacked_bytes,
)
from carrl.log.schema import CHANNELS, METADATA_NAME

Content = mmap.mmap
"""A file's bytes, of which those looked at are in memory."""

_RUN = re.compile("[0-9a-f]{16}")
_CANDIDATE = re.compile(
    rb"[\x06\x09\x0c].{4}\x00{4}(?:"
    rb"(?<=\x06.{8}).{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4}).{5}\x00{3}|"
    rb"(?<=\x09.{8}).{18}\x00\x00|"
    rb"(?<=\x0c.{8})\x05\x00{3}carrl)",
    re.DOTALL,
)
"""Opcode and length of a record of less than 4 GiB, and what else tells it from other bytes: of a chunk its compression
and a size below 1 TiB; of an attachment a name below 64 KiB; of a metadata record its name."""
_KINDS: dict[int, type[Attachment] | type[Chunk] | type[Metadata]] = {
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}

_PATIENCE_BYTES = 2**30
"""How many bytes are examined in vain, beside eight times the file's, before the search ends.

A file may be made so that every byte of it looks like the begin of a record, or so that little of it unpacks to much.
"""
_CANDIDATE_COST = 2**14
_MESSAGE_COST = 2**14
_PAID_WITH_A_BYTE = 2**11
"""Messages of a log take more than eight bytes each, packed, and so cost nothing."""


@dataclass(frozen=True, order=True)
class Place:
    """The messages of one run and topic in an intact chunk; places order as the log had them.

    Attributes:
        end_time: of the last message.
        channel: the topic's.
        number: of transitions, or of the topic's messages, before the first message.
        position: of the chunk in the damaged file.
        run: whose messages they are.
        transitions: in all of them.
        stretch: bytes of them, where they lie in no chunk; else 0.
    """

    end_time: int
    channel: int
    number: int
    position: int
    run: int = field(compare=False)
    transitions: int = field(compare=False)
    stretch: int = field(default=0, compare=False)


@dataclass
class Pieces:
    """What is intact in a damaged file.

    Attributes:
        channels: what is known of them.
        metadata: entries of records, in the order of the file.
        attachments: positions by name and checksum.
        places: of messages, in the order of the file.
        chunks: positions of the intact ones.
        unchecked: how many of the messages no checksum vouches for.
    """

    channels: Channels
    metadata: list[dict[str, str]] = field(default_factory=list)
    attachments: dict[tuple[str, str], int] = field(default_factory=dict)
    places: list[Place] = field(default_factory=list)
    chunks: set[int] = field(default_factory=set)
    unchecked: int = 0

    @property
    def found(self) -> bool:
        """Whether there is anything."""
        return bool(self.metadata or self.attachments or self.places)

    @property
    def runs(self) -> set[int]:
        """The runs that there is anything of."""
        return {place.run for place in self.places} | {int(entries["run"], 16) for entries in self.metadata}

    @property
    def run(self) -> int:
        """The run that most transitions are of, or else most messages' places, or else the first metadata record."""
        once = {(place.run, place.channel, place.number): place.transitions for place in self.places}
        shares: Counter[int] = Counter()
        for (run, _, _), transitions in once.items():
            shares[run] += transitions * len(once) + 1
        if shares:
            return shares.most_common(1)[0][0]
        return int(self.metadata[0]["run"], 16) if self.metadata else 0

    def metadata_of(self, run: int) -> dict[str, str] | None:
        """The entries of the run's metadata record; None if it is lost."""
        return next((entries for entries in self.metadata if entries["run"] == f"{run:016x}"), None)

    def attachments_of(self, entries: dict[str, str] | None) -> dict[str, int]:
        """Positions by name of those that the metadata vouch for; an attachment itself does not say whose it is."""
        return {
            name: position
            for (name, checksum), position in self.attachments.items()
            if entries is not None and entries.get(ATTACHMENT + name) == checksum
        }


def find_pieces(content: Content, index: McapIndex | None) -> Pieces:
    """All that is intact of whatever logs the file has pieces of.

    Args:
        content: of the file.
        index: of what is in it, if that is intact; what it tells of and no checksum contradicts is taken for intact.
    """
    pieces = Pieces(Channels(content, index))
    position, patience = 0, 8 * len(content) + _PATIENCE_BYTES
    while patience > 0 and (candidate := _CANDIDATE.search(content, position)):
        position = candidate.start()
        record, end = _parsed_at(content, position)
        if record is not None and _is_intact(record, content[position + HEAD.size : end]):
            patience -= max(0, _MESSAGE_COST * _add(pieces, position, record) - _PAID_WITH_A_BYTE * (end - position))
            position = end
        else:
            patience -= _CANDIDATE_COST + length_at(content, position) + _examined_bytes(record)
            position += 1
    if index is not None:
        _add_unchecked(pieces, content, index)
    return pieces


def lone_messages(content: Content) -> int:
    """How many messages lie in no chunk before the first byte that is no record's; no checksum vouches for them."""
    count = 0
    with suppress(ValueError):
        for opcode, _, _ in records(content, len(MCAP0_MAGIC), len(content)):
            if opcode not in tuple(Opcode):
                break
            count += opcode == Opcode.MESSAGE
    return count


def record_at(content: Content, position: int) -> McapRecord:
    """The record, known to be intact, that begins at this byte."""
    record, _ = _parsed_at(content, position)
    assert record is not None
    return record


def unpacked(content: Content, place: Place) -> bytes:
    """The messages at a place, and what else is among them."""
    if place.stretch:
        return content[place.position : place.position + place.stretch]
    chunk = record_at(content, place.position)
    assert isinstance(chunk, Chunk)
    return unpack(chunk)


def _add(pieces: Pieces, position: int, record: McapRecord) -> int:
    """Notes an intact record, and tells how many messages it has."""
    match record:
        case Chunk():
            pieces.chunks.add(position)
            return _add_places(pieces, position, unpack(record))
        case Attachment():
            pieces.attachments.setdefault((record.name, content_checksum(record.data)), position)
        case Metadata() if _RUN.fullmatch(record.metadata.get("run", "")):
            pieces.metadata.append(record.metadata)
    return 0


def _add_unchecked(pieces: Pieces, content: Content, index: McapIndex) -> None:
    """Notes the messages that the index tells of and that have no checksum."""
    count = 0
    for entry in index.chunks:
        position = entry.chunk_start_offset
        if position in index.stretches:
            length = entry.chunk_length
            count += _add_places(pieces, position, content[position : position + length], length)
        elif position not in pieces.chunks:
            record, _ = _parsed_at(content, position)
            if isinstance(record, Chunk) and record.uncompressed_crc == 0:
                with suppress(ValueError):
                    count += _add_places(pieces, position, unpack(record))
                    pieces.chunks.add(position)
    pieces.unchecked = 0 if index.data_checked else count


def _add_places(pieces: Pieces, position: int, content: bytes, stretch: int = 0) -> int:
    """Notes the messages of a chunk by run and topic, and tells how many there are."""
    found: dict[tuple[int, str], tuple[int, int, int]] = {}  # latest time, least number, transitions
    count = 0
    for decoded in pieces.channels.decoded(content):
        count += 1
        if decoded is not None:
            key, time, number = (decoded.run, decoded.topic), decoded.message.log_time, decoded.number
            latest, least, so_far = found.get(key, (time, number, 0))
            transitions = decoded.batch.count if decoded.batch else 0
            found[key] = max(latest, time), min(least, number), so_far + transitions
    for (run, topic), (end_time, number, transitions) in found.items():
        pieces.places.append(Place(end_time, CHANNELS[topic], number, position, run, transitions, stretch))
    return count


def _parsed_at(content: Content, position: int) -> tuple[McapRecord | None, int]:
    """What may be a record that begins at this byte, and where it ends, whatever its own length says."""
    begin = position + HEAD.size
    stream = ReadDataStream(BytesIO(content[begin : begin + length_at(content, position)]))
    try:
        record = _KINDS[content[position]].read(stream)
    except Exception:  # mcap's parsers raise whatever the bytes lead them to
        return None, begin
    return record, begin + stream.count


def _is_intact(record: McapRecord, body: bytes) -> bool:
    match record:
        case Chunk():
            with suppress(ValueError):
                return zlib.crc32(unpack(record)) == record.uncompressed_crc
        case Attachment():
            return body[-4:] == struct.pack("<I", zlib.crc32(body[:-4]))
        case Metadata():
            return record.name == METADATA_NAME and is_intact(record.metadata)
    return False


def _examined_bytes(record: McapRecord | None) -> int:
    """How many bytes the record, which is not intact, was unpacked to."""
    with suppress(ValueError):
        return unpacked_bytes(record) if isinstance(record, Chunk) else 0
    return 0
