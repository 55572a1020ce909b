"""Finds the pieces of a damaged log that can still be vouched for.

A record is looked for at every byte, for a damaged length leads nowhere; what bears a checksum that fits is intact.
"""

import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import islice

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, McapRecord, Message, Metadata

from carrl.record.codec import Batch, decode_small
from carrl.record.mcap_records import HEAD, MAX_CHUNK_BYTES, messages_in, unpack, unpacked_bytes
from carrl.record.metadata import ATTACHMENT, content_checksum, is_intact
from carrl.record.schema import CHANNELS, METADATA_NAME, SMALL_MESSAGES, TRANSITIONS

Content = mmap.mmap
"""A file's bytes, of which those looked at are in memory."""

TOPICS = {channel: topic for topic, channel in CHANNELS.items()}

_RUN = re.compile("[0-9a-f]{16}")
_CANDIDATE = re.compile(
    rb"[\x06\x09\x0c].{4}\x00{4}(?:"
    rb"(?<=\x06.{8}).{28}(?:\x04\x00{3}zstd|\x00{4}).{5}\x00{3}|"
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
_MAX_RECORD_BYTES = MAX_CHUNK_BYTES + 2**10

_PATIENCE_BYTES = 2**30
"""How many bytes are examined in vain, beside eight times the file's, before the search ends.

A file may be made so that every byte of it looks like the begin of a record, or so that little of it unpacks to much.
"""
_CANDIDATE_COST = 2**14
_MESSAGE_COST = 2**14
_PAID_WITH_A_BYTE = 2**11
"""Messages of a log take more than eight bytes each, packed, and so cost nothing."""
_MAX_MESSAGES = 2**17
"""How many messages of a chunk are read; the writer's have some ten thousand."""


@dataclass(frozen=True)
class Decoded:
    """A message that says what its topic's messages say; `batch` if it is one of transitions."""

    message: Message
    topic: str
    run: int
    batch: Batch | None

    @property
    def number(self) -> int:
        """How many transitions, or messages of the topic, come before it."""
        return self.batch.offset if self.batch else self.message.sequence


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
    """

    end_time: int
    channel: int
    number: int
    position: int
    run: int = field(compare=False)
    transitions: int = field(compare=False)


@dataclass
class Pieces:
    """What is intact in a damaged file.

    Attributes:
        metadata: entries of records, in the order of the file.
        attachments: positions by name and checksum.
        places: of messages, in the order of the file.
    """

    metadata: list[dict[str, str]] = field(default_factory=list)
    attachments: dict[tuple[str, str], int] = field(default_factory=dict)
    places: list[Place] = field(default_factory=list)

    @property
    def found(self) -> bool:
        """Whether there is anything."""
        return bool(self.metadata or self.attachments or self.places)

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


def find_pieces(content: Content) -> Pieces:
    """All that is intact of whatever logs the file has pieces of."""
    pieces = Pieces()
    position, patience = 0, 8 * len(content) + _PATIENCE_BYTES
    while patience > 0 and (candidate := _CANDIDATE.search(content, position)):
        position = candidate.start()
        record, end = _parsed_at(content, position)
        if record is not None and _is_intact(record, content[position + HEAD.size : end]):
            patience -= max(0, _MESSAGE_COST * _add(pieces, position, record) - _PAID_WITH_A_BYTE * (end - position))
            position = end
        else:
            patience -= _CANDIDATE_COST + _length_at(content, position) + _examined_bytes(record)
            position += 1
    return pieces


def record_at(content: Content, position: int) -> McapRecord:
    """The record, known to be intact, that begins at this byte."""
    record, _ = _parsed_at(content, position)
    assert record is not None
    return record


def decoded_messages(chunk: Chunk) -> Iterator[Decoded | None]:
    """Yields the messages of an intact chunk, None for those that are not of this format."""
    with suppress(ValueError):  # whoever wrote records that do not fit their chunk is to blame
        for message in islice(messages_in(unpack(chunk)), _MAX_MESSAGES):
            try:
                yield _decode(message)
            except ValueError:
                yield None


def _decode(message: Message) -> Decoded | None:
    topic = TOPICS.get(message.channel_id, "")
    if topic == TRANSITIONS:
        batch = Batch.decode(message.data)
        return Decoded(message, topic, batch.run, batch)
    if topic in SMALL_MESSAGES:
        return Decoded(message, topic, decode_small(topic, message.data)[0], None)
    return None


def _add(pieces: Pieces, position: int, record: McapRecord) -> int:
    """Notes an intact record, and tells how many messages it has."""
    match record:
        case Chunk():
            return _add_places(pieces, position, record)
        case Attachment():
            pieces.attachments.setdefault((record.name, content_checksum(record.data)), position)
        case Metadata() if _RUN.fullmatch(record.metadata.get("run", "")):
            pieces.metadata.append(record.metadata)
    return 0


def _add_places(pieces: Pieces, position: int, chunk: Chunk) -> int:
    found: dict[tuple[int, str], tuple[int, int, int]] = {}  # latest time, least number, transitions
    messages = list(map(_digest, decoded_messages(chunk)))
    for key, end_time, number, transitions in filter(None, messages):
        latest, least, so_far = found.get(key, (end_time, number, 0))
        found[key] = (max(latest, end_time), min(least, number), so_far + transitions)
    for (run, topic), (end_time, number, transitions) in found.items():
        pieces.places.append(Place(end_time, CHANNELS[topic], number, position, run, transitions))
    return len(messages)


def _digest(decoded: Decoded | None) -> tuple[tuple[int, str], int, int, int] | None:
    """What a place tells of a message: run and topic, time, number, transitions."""
    if decoded is None:
        return None
    transitions = decoded.batch.count if decoded.batch else 0
    return (decoded.run, decoded.topic), decoded.message.log_time, decoded.number, transitions


def _parsed_at(content: Content, position: int) -> tuple[McapRecord | None, int]:
    """What may be a record that begins at this byte, and where it ends, whatever its own length says."""
    begin = position + HEAD.size
    stream = ReadDataStream(BytesIO(content[begin : begin + _length_at(content, position)]))
    try:
        record = _KINDS[content[position]].read(stream)
    except Exception:  # mcap's parsers raise whatever the bytes lead them to
        return None, begin
    return record, begin + stream.count


def _length_at(content: Content, position: int) -> int:
    """How many bytes the body of the record there may have."""
    _, length = HEAD.unpack_from(content, position)
    return min(length, _MAX_RECORD_BYTES, len(content) - position - HEAD.size)


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
