"""A log's file before its first chunk, and the names of those in which it goes on."""

from collections.abc import Mapping
from pathlib import Path

from carrl.log.mcap_file import McapFile
from carrl.log.schema import MESSAGE_NAMES, METADATA_NAME, schema_bytes

_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json", ".csv": "text/csv", ".txt": "text/plain"}


def begin_log(path: Path, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> McapFile:
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
        for topic, name in MESSAGE_NAMES.items():
            file.add_channel(topic, name, schema_bytes(topic), {"run": metadata["run"]})
    except BaseException:
        file.close()
        raise
    return file


def part_path(first: Path, part: int) -> Path:
    """The file in which a log goes on: `train.mcap`, `train-1.mcap`, `train-2.mcap` and so on."""
    return first.with_stem(f"{first.stem}-{part}") if part else first
