"""The messages of a damaged log, told apart by what its channel records say, and by what they say themselves."""

import mmap
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from mcap.opcode import Opcode
from mcap.records import Channel, Message

from carrl.log.codec import Batch, decode_small, encode_small
from carrl.log.mcap_records import message_of, parse, records_in
from carrl.log.mcap_scan import McapIndex
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import CHANNELS, SMALL_MESSAGES, TRANSITIONS

TOPICS = {channel: topic for topic, channel in CHANNELS.items()}
"""The topic of each channel in a log that CarRL wrote; another program may have numbered the channels otherwise."""

Topics = dict[int, list[str]]
"""What the channel records say of each number: perhaps two things, if a file is damaged or has pieces of two logs."""

_MAX_MESSAGES = 2**17
"""How many messages of a chunk are read; the writer's have some ten thousand."""
_CHANNEL = re.compile(
    rb"\x04.{4}\x00{4}(.{2}).{2}(?:%s)\x08\x00{3}protobuf"
    % b"|".join(struct.pack("<I", len(topic)) + topic.encode() for topic in CHANNELS),
    re.DOTALL,
)
"""A channel record of one of the topics; MCAP keeps no CRC of it."""


@dataclass(frozen=True)
class Decoded:
    """A message that says what its topic's messages say; `batch` if it is one of transitions, else `small`."""

    message: Message
    topic: str
    run: int
    batch: Batch | None = None
    small: Episode | Metrics | None = None

    @property
    def number(self) -> int:
        """How many transitions, or messages of the topic, come before it."""
        return self.batch.offset if self.batch else self.message.sequence


def topics_in(content: mmap.mmap, index: McapIndex | None) -> Topics:
    """The topics of the channels, as the index tells, or else the channel records wherever they are in the file."""
    if index is not None:
        return {number: [channel.topic] for number, channel in index.channels.items()}
    topics: Topics = {}
    for match in _CHANNEL.finditer(content):
        [number] = struct.unpack("<H", match[1])
        _note_topic(topics, number, content[match.start() + 17 : match.end() - 12].decode())
    return topics


def _note_topic(topics: Topics, number: int, topic: str) -> None:
    known = topics.setdefault(number, [])
    if topic not in known:
        known.append(topic)


def _decode(message: Message, topics: Topics) -> Decoded | None:
    known = topics.get(message.channel_id)
    for topic in known or [TOPICS.get(message.channel_id, "")]:
        with suppress(ValueError):
            if decoded := _decode_as(topic, message, is_sure=known == [topic]):
                return decoded
    return None


def _decode_as(topic: str, message: Message, is_sure: bool) -> Decoded | None:
    """The message as one of the topic; if it may be of another, only if it says nothing but what this topic's do."""
    if topic == TRANSITIONS:
        batch = Batch.decode(message.data)
        return Decoded(message, topic, batch.run, batch=batch)
    if topic in SMALL_MESSAGES:
        run, small = decode_small(topic, message.data)
        if is_sure or encode_small(topic, run, small) == message.data:
            return Decoded(message, topic, run, small=small)
    return None


def decoded_messages(messages: bytes, topics: Topics) -> Iterator[Decoded | None]:
    """Yields the messages of an intact chunk, None for those that are not of this format; notes its channels."""
    with suppress(ValueError):  # whoever wrote records that do not fit their chunk is to blame
        for opcode, body in islice(records_in(messages), _MAX_MESSAGES):
            if opcode == Opcode.MESSAGE:
                yield _decode(message_of(body), topics)
            elif opcode == Opcode.CHANNEL:
                channel = parse(opcode, body)
                assert isinstance(channel, Channel)
                _note_topic(topics, channel.id, channel.topic)
