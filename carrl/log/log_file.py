"""A log's file before its first chunk, with its metadata record, and the names of those in which it goes on."""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path

from mcap.records import Channel
from mcap.records import Schema as McapSchema

from carrl.errors import LogError
from carrl.log.mcap_write import McapFile, serialise
from carrl.log.schema import (
    CHANNELS,
    COLUMNS_ENTRY,
    FORMAT_VERSION,
    MESSAGE_NAMES,
    METADATA_NAME,
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
