"""Reads a log from its first byte to its last and compares every part with every other."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from carrl.record.codec import row_shapes
from carrl.record.mcap_index import check_magic, damaged, open_log
from carrl.record.mcap_records import HEAD, MAX_CHUNK_BYTES, check_crc, parse
from carrl.record.reader import Log
from carrl.record.schema import EPISODES, METRICS

_MAX_RECORD_BYTES = MAX_CHUNK_BYTES + 2**10


@dataclass(frozen=True)
class IntactLog:
    """How much an intact log holds."""

    transitions: int
    episodes: int
    metrics: int


def verify(path: str | Path) -> IntactLog:
    """Checks every CRC of a log, its index, and that every message says what its topic's messages say.

    Raises:
        LogError: the file cannot be read.
        DamagedLogError: it is not an intact log.
    """
    path = Path(path)
    offsets = _walk(path)
    with Log(path) as log:
        for what, expected in log.places.items():
            if offsets[what] != expected:
                raise damaged(path, f"its index does not tell where its {what} records are")
        for name in log.attachments:
            log.attachment(name)
        transitions, shapes = 0, log.row_shapes
        for batch in log.coded_batches():
            if batch.offset != transitions:
                raise damaged(path, f"{transitions} transitions are followed by number {batch.offset}")
            if row_shapes(batch.columns) != shapes:
                raise damaged(path, f"transition {transitions} has not as many rays as those before")
            transitions += batch.count
        found = {EPISODES: sum(1 for _ in log.episodes()), METRICS: sum(1 for _ in log.metrics())}
        for topic, count in found.items():
            if log.messages.get(topic, 0) != count:
                raise damaged(
                    path, f"its summary tells of {log.messages.get(topic, 0)} messages of {topic}, not {count}"
                )
        return IntactLog(transitions, found[EPISODES], found[METRICS])


def _walk(path: Path) -> dict[str, list[int]]:
    """Where the records of each kind begin that the index tells of; checks the CRCs of the file's sections."""
    file, size = open_log(path)
    with file:
        check_magic(path, file, size)
        offsets: dict[str, list[int]] = {"chunk": [], "attachment": [], "metadata": []}
        try:
            for offset, opcode in _verified_records(file, size):
                name = Opcode(opcode).name.lower()
                if name in offsets:
                    offsets[name].append(offset)
        except (ValueError, OSError, struct.error) as error:
            raise damaged(path, error) from error
    return offsets


def _verified_records(file: BufferedReader, size: int) -> Iterator[tuple[int, int]]:
    """Yields (offset, opcode) of each record of the data section; has checked both sections' CRCs in the end."""
    crc = zlib.crc32(file.read(len(MCAP0_MAGIC)))
    data_ended = False
    while True:
        offset = file.tell()
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head)
        if length > min(size - file.tell(), _MAX_RECORD_BYTES):
            raise ValueError(f"a record of {length} bytes at {offset}")
        body = file.read(length)
        if opcode == Opcode.FOOTER:
            check_crc("the summary", body[-4:], zlib.crc32(head + body[:-4], crc))
            break
        if opcode == Opcode.DATA_END:
            check_crc("the data section", body, crc)
            crc, data_ended = 0, True
            continue
        crc = zlib.crc32(body, zlib.crc32(head, crc))
        parse(opcode, body)
        if not data_ended:
            yield offset, opcode
    if not data_ended or file.read() != MCAP0_MAGIC:
        raise ValueError("the file's last records are out of order")
