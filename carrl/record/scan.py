"""One pass over a log's records, noting what they say and refusing what is not a log of this format."""

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from carrl.errors import LogError
from carrl.record.codec import check_row_shapes, decode, row_shapes
from carrl.record.container import intact_records
from carrl.record.schema import FORMAT_VERSION, MESSAGE_NAME, METADATA_NAME, TOPIC


@dataclass
class Scan:
    """One pass over a log, and what its records have said so far.

    Attributes:
        path: the file.
        metadata: the entries of the record "carrl".
        attachments: size of each by name, bytes.
        topics: messages, and their bytes before compression, by topic.
        row_shapes: shape of one transition's value in each column; None before the first message.
    """

    path: Path
    metadata: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    topics: dict[str, tuple[int, int]] = field(default_factory=dict)
    row_shapes: dict[str, tuple[int, ...]] | None = None
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, Channel] = field(default_factory=dict)

    def batches(self) -> Iterator[tuple[Message, dict[str, np.ndarray]]]:
        """Yields each message of transitions with its columns."""
        for record in self.records():
            if isinstance(record, Message) and self._count(record) == TOPIC:
                try:
                    columns = decode(record.data)
                    self.row_shapes = self.row_shapes or row_shapes(columns)
                    check_row_shapes(columns, self.row_shapes)
                except ValueError as error:
                    raise self._not_a_log(f"message {record.sequence} is wrong: {error}") from error
                yield record, columns

    def records(self) -> Generator[McapRecord, None, None]:
        """Yields every record, having noted what it says; after the last one the file is known to be a log."""
        for record in intact_records(self.path):
            match record:
                case Metadata(name=name, metadata=entries) if name == METADATA_NAME:
                    self.metadata |= entries
                    self._check_version()
                case Attachment():
                    self.attachments[record.name] = len(record.data)
                case Schema():
                    self._schemas[record.id] = record
                case Channel():
                    self._channels[record.id] = record
                    self.topics.setdefault(record.topic, (0, 0))
                    self._check_schema(record)
            yield record
        if TOPIC not in self.topics:
            raise self._not_a_log(f"no topic {TOPIC} among: {quoted_names(self.topics)}")
        if not self.metadata:
            raise self._not_a_log(f"no metadata record '{METADATA_NAME}'")

    def _count(self, message: Message) -> str:
        if message.channel_id not in self._channels:
            raise self._not_a_log(f"a message on channel {message.channel_id}, which is not described")
        topic = self._channels[message.channel_id].topic
        messages, message_bytes = self.topics[topic]
        self.topics[topic] = (messages + 1, message_bytes + len(message.data))
        return topic

    def _check_version(self) -> None:
        found = self.metadata.get("format_version")
        if found != str(FORMAT_VERSION):
            raise LogError(
                f"log '{self.path}': has format version {found!r:.20}, this carrl reads {FORMAT_VERSION}; "
                "use the version of carrl that wrote it"
            )

    def _check_schema(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        kind = (channel.message_encoding, schema.encoding, schema.name) if schema else None
        if channel.topic == TOPIC and kind != ("protobuf", "protobuf", MESSAGE_NAME):
            raise self._not_a_log(f"topic {TOPIC} has the schema {kind!r:.100}, not {MESSAGE_NAME} in protobuf")

    def _not_a_log(self, found: str) -> LogError:
        return LogError(f"log '{self.path}': is not a CarRL log: {found}; give the train.mcap of a run")


def quoted_names(names: Iterable[str]) -> str:
    """Quoted and cut, for a file may hold any text as a name."""
    return f"{', '.join(map(repr, names)) or 'none':.200}"
