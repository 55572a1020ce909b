"""Makes a finished log of all that is intact in one that was cut off or damaged.

Indices are written anew. Pieces of other logs are told apart by the number of the run; pieces that are there twice, or
in another order, by the number of transitions before them.
"""

import json
import mmap
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from uuid import uuid4

from mcap.records import Attachment, Chunk, Message, Metadata
from mcap.writer import MCAP0_MAGIC

from carrl.errors import DamagedLogError, LogError
from carrl.record.codec import Batch, decode_small
from carrl.record.mcap_file import McapFile
from carrl.record.mcap_index import open_log
from carrl.record.mcap_records import messages_in, unpack
from carrl.record.metadata import ATTACHMENT, content_checksum, describe
from carrl.record.salvage import Content, intact_records, record_at
from carrl.record.schema import CHANNELS, EPISODES, METRICS, RECOVERY_NAME, SMALL_MESSAGES, TRANSITIONS
from carrl.record.writer import begin_log

_RUN = re.compile("[0-9a-f]{16}")
_TOPICS = {channel: topic for topic, channel in CHANNELS.items()}


@dataclass(frozen=True)
class Recovery:
    """What was salvaged, and what was not.

    Attributes:
        finished: whether the damaged file ended as a finished one does.
        transitions: salvaged.
        episodes: salvaged.
        metrics: salvaged.
        transitions_lost: missing before or between salvaged ones; how many followed the last one nobody knows.
        episodes_lost: likewise.
        metadata_lost: whether what the log says of its run is lost.
        attachments: salvaged.
        attachments_lost: those that the metadata names besides.
    """

    finished: bool
    transitions: int
    episodes: int
    metrics: int
    transitions_lost: int
    episodes_lost: int
    metadata_lost: bool
    attachments: tuple[str, ...]
    attachments_lost: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether the file was finished, and nothing of it is known to be lost."""
        lost = self.transitions_lost or self.episodes_lost or self.metadata_lost or self.attachments_lost
        return self.finished and not lost


def recover(source: Path, target: Path) -> Recovery:
    """Writes a new, finished log of all that is intact in a damaged one, and tells what was lost.

    The target appears whole or not at all; the source is left as it is.

    Raises:
        LogError: the source cannot be read, the target exists or cannot be written.
        DamagedLogError: the source is empty, or no log and no piece of one.
    """
    file, _ = open_log(source)
    with file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if target.exists():
            raise LogError(f"log '{target}': is there already; give the name of a new file")
        pieces = _search(content)
        if not pieces.found and content[: len(MCAP0_MAGIC)] != MCAP0_MAGIC[: len(content)]:
            raise DamagedLogError(f"log '{source}': holds nothing of a CarRL log; give the train.mcap of a run")
        partial = target.with_name(f".{target.name}.{uuid4().hex}.partial")
        try:
            recovery = _rewrite(content, pieces, partial)
            partial.rename(target)
        except OSError as error:
            raise LogError(f"log '{target}': cannot be written: {error.strerror}; give another place for it") from error
        finally:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
    return recovery


@dataclass(frozen=True, order=True)
class _Place:
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
class _Pieces:
    """What is intact: entries of metadata records, positions of attachments by name and checksum, messages."""

    metadata: list[dict[str, str]] = field(default_factory=list)
    attachments: dict[tuple[str, str], int] = field(default_factory=dict)
    places: list[_Place] = field(default_factory=list)

    @property
    def found(self) -> bool:
        return bool(self.metadata or self.attachments or self.places)

    @property
    def run(self) -> int:
        """The run that most transitions are of, or else most messages' places, or else the first metadata record."""
        shares: Counter[int] = Counter()
        for place in self.places:
            shares[place.run] += place.transitions * len(self.places) + 1
        if shares:
            return shares.most_common(1)[0][0]
        return int(self.metadata[0]["run"], 16) if self.metadata else 0

    def metadata_of(self, run: int) -> dict[str, str] | None:
        return next((entries for entries in self.metadata if entries["run"] == f"{run:016x}"), None)

    def attachments_of(self, entries: dict[str, str] | None) -> dict[str, int]:
        """Positions by name of those that the metadata names; without metadata, of all, if all are of one log."""
        if entries is not None:
            return {
                name: position
                for (name, checksum), position in self.attachments.items()
                if entries.get(ATTACHMENT + name) == checksum
            }
        positions = {name: position for (name, _), position in self.attachments.items()}
        return positions if not self.metadata and len(positions) == len(self.attachments) else {}


@dataclass(frozen=True)
class _Decoded:
    """A message that says what its topic's messages say; `batch` if it is one of transitions."""

    message: Message
    topic: str
    run: int
    batch: Batch | None

    @property
    def number(self) -> int:
        """How many transitions, or messages of the topic, come before it."""
        return self.batch.offset if self.batch else self.message.sequence


def _search(content: Content) -> _Pieces:
    pieces = _Pieces()
    for position, record in intact_records(content):
        if isinstance(record, Chunk):
            pieces.places += _places(position, record)
        elif isinstance(record, Attachment):
            pieces.attachments.setdefault((record.name, content_checksum(record.data)), position)
        elif isinstance(record, Metadata) and _RUN.fullmatch(record.metadata.get("run", "")):
            pieces.metadata.append(record.metadata)
    return pieces


def _messages(chunk: Chunk) -> Iterator[_Decoded]:
    """The messages of an intact chunk that are of this format."""
    with suppress(ValueError):  # whoever wrote records that do not fit their chunk is to blame
        for message in messages_in(unpack(chunk)):
            topic = _TOPICS.get(message.channel_id, "")
            with suppress(ValueError):
                if topic == TRANSITIONS:
                    batch = Batch.decode(message.data)
                    yield _Decoded(message, topic, batch.run, batch)
                elif topic in SMALL_MESSAGES:
                    yield _Decoded(message, topic, decode_small(topic, message.data)[0], None)


def _places(position: int, chunk: Chunk) -> list[_Place]:
    """The places in the intact chunk at this position."""
    groups: dict[tuple[int, str], list[_Decoded]] = {}
    for decoded in _messages(chunk):
        groups.setdefault((decoded.run, decoded.topic), []).append(decoded)
    return [
        _Place(
            end_time=max(decoded.message.log_time for decoded in messages),
            channel=CHANNELS[topic],
            number=min(decoded.number for decoded in messages),
            position=position,
            run=run,
            transitions=sum(decoded.batch.count for decoded in messages if decoded.batch),
        )
        for (run, topic), messages in groups.items()
    ]


def _rewrite(content: Content, pieces: _Pieces, path: Path) -> Recovery:
    """Writes the pieces of one run as a log of their own."""
    run = pieces.run
    entries = pieces.metadata_of(run)
    attachments = {}
    for name, position in pieces.attachments_of(entries).items():
        record, _ = record_at(content, position)
        assert isinstance(record, Attachment)
        attachments[name] = record.data
    named = {key.removeprefix(ATTACHMENT) for key in entries or {} if key.startswith(ATTACHMENT)}
    file = begin_log(path, entries or describe(run, 0, {}, attachments), attachments)
    try:
        copy = _Copy(file, run)
        for place in sorted(place for place in pieces.places if place.run == run):
            record, _ = record_at(content, place.position)
            assert isinstance(record, Chunk)
            copy.add(record, _TOPICS[place.channel])
        recovery = Recovery(
            finished=content[-len(MCAP0_MAGIC) :] == MCAP0_MAGIC,
            transitions=copy.written[TRANSITIONS],
            episodes=copy.written[EPISODES],
            metrics=copy.written[METRICS],
            transitions_lost=copy.transitions_lost,
            episodes_lost=copy.episodes_lost,
            metadata_lost=entries is None,
            attachments=tuple(attachments),
            attachments_lost=tuple(sorted(named - attachments.keys())),
        )
        file.add_metadata(RECOVERY_NAME, {key: json.dumps(value) for key, value in asdict(recovery).items()})
        file.finish()
    finally:
        file.close()
    return recovery


class _Copy:
    """The new log, to which the messages of the old one come in their order, each once.

    Attributes:
        written: transitions, and messages of the other topics.
        transitions_lost: missing so far.
    """

    def __init__(self, file: McapFile, run: int) -> None:
        self._file, self._run = file, run
        self.written: Counter[str] = Counter()
        self.transitions_lost = 0
        self._next_offset = 0
        self._sequences: Counter[str] = Counter()
        self._seen: dict[str, set[int]] = {topic: set() for topic in SMALL_MESSAGES}

    @property
    def episodes_lost(self) -> int:
        seen = self._seen[EPISODES]
        return max(seen) + 1 - len(seen) if seen else 0

    def add(self, chunk: Chunk, topic: str) -> None:
        """Appends what the chunk holds of the topic."""
        own = [decoded for decoded in _messages(chunk) if (decoded.run, decoded.topic) == (self._run, topic)]
        messages = [message for decoded in own if (message := self._renumbered(decoded))]
        if messages:
            self._file.add_chunk(messages)

    def _renumbered(self, decoded: _Decoded) -> Message | None:
        """The message as it is to be written; None if it has been already."""
        message, topic, batch = decoded.message, decoded.topic, decoded.batch
        content = message.data
        if batch is None:
            if message.sequence in self._seen[topic]:
                return None
            self._seen[topic].add(message.sequence)
            self.written[topic] += 1
        else:
            if batch.offset < self._next_offset:
                return None
            self.transitions_lost += batch.offset - self._next_offset
            self._next_offset = batch.offset + batch.count
            content = replace(batch, offset=self.written[topic]).encode()
            self.written[topic] += batch.count
        sequence = self._sequences[topic]
        self._sequences[topic] += 1
        return replace(message, data=content, sequence=sequence % 2**32)
