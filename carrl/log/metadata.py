"""The metadata record of a log: the format's own entries, those of the run, and a checksum of them all."""

import json
import zlib
from collections.abc import Mapping

from carrl.errors import LogError
from carrl.log.schema import COLUMNS, FORMAT_VERSION, TIME_BASE

CHECKSUM = "entries_crc32"
"""The entry with the checksum of the others; MCAP keeps no CRC of a metadata record."""


ATTACHMENT = "attachment_crc32."
"""What the entries begin with that tell which attachments there are, as these do not say what log they are of."""


def describe(run: int, part: int, entries: Mapping[str, str], attachments: Mapping[str, bytes]) -> dict[str, str]:
    """The whole record: the format's own entries, and these of the run.

    Raises:
        LogError: the run uses a key of the format.
    """
    own = {"format_version": str(FORMAT_VERSION), "time_base": TIME_BASE, "run": f"{run:016x}", "part": str(part)}
    own |= {f"column.{column.name}": column.description for column in COLUMNS}
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
