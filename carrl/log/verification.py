"""Reads a log from its first byte to its last and compares every part with every other."""

import json
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode

from carrl.log.log_file import ATTACHMENT
from carrl.log.mcap_read import (
    FileContent,
    IndexedFile,
    check_magic,
    damaged,
    naming_damage,
    open_log,
    verified_records,
)
from carrl.log.mcap_records import parse
from carrl.log.reader import Log, quoted_names
from carrl.log.schema import CHANNELS, EPISODES, METRICS, TRANSITIONS


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
    with IndexedFile(path) as file:
        for opcode, expected in file.places.items():
            if offsets[opcode] != expected:
                raise damaged(path, f"its index does not tell where its {Opcode(opcode).name.lower()} records are")
    with Log(path) as log:
        _check_is_all_there(log)
        transitions, batches = 0, 0
        for batch in log.coded_batches():
            if batch.offset != transitions:
                raise damaged(path, f"{transitions} transitions are followed by number {batch.offset}")
            transitions, batches = transitions + batch.count, batches + 1
        lengths = [episode.length for episode in log.episodes()]
        if lengths and not batches and log.metadata["part"] == "0" and not log.recovery:
            raise damaged(path, f"its ended episodes have {sum(lengths)} steps, but it has no transitions")
        found = {TRANSITIONS: batches, EPISODES: len(lengths), METRICS: sum(1 for _ in log.metrics())}
        for topic, count in found.items():
            if log.messages.get(topic, 0) != count:
                raise damaged(
                    path, f"its summary tells of {log.messages.get(topic, 0)} messages of {topic}, not {count}"
                )
        return IntactLog(transitions, found[EPISODES], found[METRICS])


def _check_is_all_there(log: Log) -> None:
    """Raises DamagedLogError where a topic or an attachment is missing, but for what recovery has told of."""
    for topic in CHANNELS:
        if topic not in log.messages:
            raise damaged(log.path, f"it has no topic {topic}, which every log has")
    named = {key.removeprefix(ATTACHMENT) for key in log.metadata if key.startswith(ATTACHMENT)}
    lost = sorted(named - log.attachments.keys() - _known_lost(log))
    if lost:
        raise damaged(log.path, f"it lacks the attachments that its metadata tells of: {quoted_names(lost)}")
    for name in log.attachments:
        log.attachment(name)


def _known_lost(log: Log) -> set[str]:
    """The attachments that a recovered log says were lost before."""
    with suppress(ValueError, TypeError, RecursionError):  # it is text that any program may have written
        return set(map(str, json.loads(log.recovery.get("attachments_lost", "[]"))))
    return set()


def _walk(path: Path) -> dict[int, list[int]]:
    """Where the records of each kind begin, by opcode; checks the CRCs of the file's sections."""
    file, size = open_log(path)
    with file:
        content = FileContent(file, size)
        check_magic(path, content)
        offsets: dict[int, list[int]] = defaultdict(list)
        with naming_damage(path):
            for offset, opcode, body in verified_records(content):
                parse(opcode, body)
                offsets[opcode].append(offset)
    return offsets
