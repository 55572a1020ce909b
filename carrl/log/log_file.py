"""A log's file: what it has before its first chunk, the channels that say what messages are, and names of its parts."""

import json
import mmap
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Message
from mcap.records import Schema as McapSchema

from carrl.errors import LogError
from carrl.log import version2
from carrl.log.codec import Batch, decode_small, encode_small
from carrl.log.mcap_records import HEAD, McapIndex, length_at, message_of, parse, records_in
from carrl.log.mcap_write import McapFile, serialise
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import (
    CHANNELS,
    COLUMNS_ENTRY,
    FORMAT_VERSION,
    MESSAGE_NAMES,
    METADATA_NAME,
    SMALL_MESSAGES,
    TOPICS,
    TRANSITIONS,
    Schema,
    schema_bytes,
)

TIME_BASE = (
    "simulated nanoseconds since the start of the run; a batch's log_time is that of its last transition, "
    "its publish_time that of its first"
)
CHECKSUM = "entries_crc32"
"""The entry with the checksum of the others; MCAP keeps no CRC of a metadata record."""
ATTACHMENT = "attachment_crc32."
"""What the entries begin with that tell which attachments there are, as these do not say what log they are of."""

_MAX_MESSAGES = 2**17
"""How many messages of a chunk are read; the writer's have some ten thousand."""
_CHANNEL = re.compile(
    rb"\x04.{4}\x00{4}.{4}(?:%s)\x08\x00{3}protobuf"
    % b"|".join(struct.pack("<I", len(topic)) + topic.encode() for topic in CHANNELS),
    re.DOTALL,
)
"""A channel record of one of the topics; MCAP keeps no CRC of it."""
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json", ".csv": "text/csv", ".txt": "text/plain"}


def describe(
    run: int, part: int, entries: Mapping[str, str], attachments: Mapping[str, bytes], version: int = FORMAT_VERSION
) -> dict[str, str]:
    """The whole metadata record: the format's own entries, and these of the run.

    Raises:
        LogError: the run uses a key of the format.
    """
    own = {"format_version": str(version), "time_base": TIME_BASE, "run": f"{run:016x}", "part": str(part)}
    own |= {ATTACHMENT + name: content_checksum(content) for name, content in attachments.items()}
    taken = sorted((own.keys() | {CHECKSUM}) & entries.keys())
    if taken:
        raise LogError(f"log metadata: the key '{taken[0]}' is the format's own; choose another key")
    return with_checksum({**own, **entries})


def with_checksum(entries: Mapping[str, str]) -> dict[str, str]:
    """The entries with their checksum, in place of any other."""
    return {**entries, CHECKSUM: _checksum(entries)}


def is_intact(entries: Mapping[str, str]) -> bool:
    """Whether the checksum fits the entries."""
    return entries.get(CHECKSUM) == _checksum(entries)


def content_checksum(content: bytes) -> str:
    """CRC-32 in hexadecimal digits."""
    return f"{zlib.crc32(content):08x}"


def _checksum(entries: Mapping[str, str]) -> str:
    """Of the other entries as sorted JSON."""
    others = {key: value for key, value in entries.items() if key != CHECKSUM}
    return content_checksum(json.dumps(others, sort_keys=True).encode())


def begin_log(path: Path, metadata: Mapping[str, str], attachments: Mapping[str, bytes], schema: Schema) -> McapFile:
    """A file with all that a log has before its first chunk.

    Raises:
        OSError, ValueError: the file cannot be written.
    """
    file = McapFile(path)
    try:
        file.add_metadata(METADATA_NAME, metadata)
        for name, content in attachments.items():
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            file.add_attachment(name, media_type, content)
        for topic in CHANNELS:
            file.add_channel(*_channel(topic, metadata["run"], schema))
    except BaseException:
        file.close()
        raise
    return file


def chunk_beginning(run: str, schema: Schema) -> bytes:
    """What a chunk of transitions begins with, so that it can be read even where nothing else is left of the file."""
    return serialise(*_channel(TRANSITIONS, run, schema)) if schema.version == FORMAT_VERSION else b""


def part_path(first: Path, part: int) -> Path:
    """The file in which a log goes on: `train.mcap`, `train-1.mcap`, `train-2.mcap` and so on."""
    return first.with_stem(f"{first.stem}-{part}") if part else first


def _channel(topic: str, run: str, schema: Schema) -> tuple[McapSchema, Channel]:
    """The records of a topic; that of the transitions describes their columns, which version 2 did not."""
    number, name, entries = CHANNELS[topic], MESSAGE_NAMES[topic], {"run": run}
    if topic == TRANSITIONS and schema.version == FORMAT_VERSION:
        entries[COLUMNS_ENTRY] = schema.as_json()
    return (
        McapSchema(id=number, name=name, encoding="protobuf", data=schema_bytes(topic, schema)),
        Channel(id=number, topic=topic, message_encoding="protobuf", schema_id=number, metadata=entries),
    )


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


class Channels:
    """What channel records say of each number: perhaps two things, if a file is damaged or has pieces of two logs.

    Attributes:
        schemas: of transitions, as described so far.
    """

    def __init__(self, content: mmap.mmap, index: McapIndex | None) -> None:
        """Takes the channels that the index tells of, or else all that are anywhere in the file."""
        self._topics: dict[int, list[str]] = {}
        self.schemas: list[Schema] = []
        for channel in index.channels.values() if index else ():
            self.note(channel)
        for match in _CHANNEL.finditer(content) if index is None else ():
            position = match.start()
            body = content[position + HEAD.size : position + HEAD.size + length_at(content, position)]
            with suppress(ValueError):
                self.note(parse(Opcode.CHANNEL, body))

    def note(self, channel: McapRecord | None) -> None:
        """Takes what a channel record says."""
        assert isinstance(channel, Channel)
        topics = self._topics.setdefault(channel.id, [])
        if channel.topic not in topics:
            topics.append(channel.topic)
        if channel.topic == TRANSITIONS and COLUMNS_ENTRY in channel.metadata:
            with suppress(ValueError):
                schema = Schema.from_json(channel.metadata[COLUMNS_ENTRY])
                if schema not in self.schemas:
                    self.schemas.append(schema)

    def decoded(self, messages: bytes) -> Iterator[Decoded | None]:
        """Yields the messages of an intact chunk, None for those that are not of this format; notes its channels."""
        with suppress(ValueError):  # whoever wrote records that do not fit their chunk is to blame
            for opcode, body in islice(records_in(messages), _MAX_MESSAGES):
                if opcode == Opcode.MESSAGE:
                    yield self._decode(message_of(body))
                elif opcode == Opcode.CHANNEL:
                    self.note(parse(opcode, body))

    def _decode(self, message: Message) -> Decoded | None:
        known = self._topics.get(message.channel_id)
        for topic in known or [TOPICS.get(message.channel_id, "")]:
            if topic == TRANSITIONS and (batch := self._batch(message.data)):
                return Decoded(message, topic, batch.run, batch=batch)
            if topic in SMALL_MESSAGES:
                with suppress(ValueError):
                    run, small = decode_small(topic, message.data)
                    # One that may be of another topic must say nothing but what this topic's do.
                    if known == [topic] or encode_small(topic, run, small) == message.data:
                        return Decoded(message, topic, run, small=small)
        return None

    def _batch(self, message: bytes) -> Batch | None:
        """The transitions of a message, by whichever columns it has; version 2 did not describe its own."""
        for schema in self.schemas:
            with suppress(ValueError):
                return Batch.decode(message, schema)
        with suppress(ValueError):
            return Batch.decode(message, version2.file_schema(message))
        return None
