"""Makes a finished log of all that is intact in one that was cut off or damaged.

Indices are written anew. Pieces of other logs are told apart by the number of the run; pieces that are there twice, or
in another order, by the number of transitions before them.
"""

import json
import mmap
import os
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from uuid import uuid4

from mcap.records import Attachment, Message
from mcap.writer import MCAP0_MAGIC

from carrl.errors import DamagedLogError, LogError
from carrl.log import version2
from carrl.log.log_file import ATTACHMENT, Decoded, begin_log, chunk_beginning, describe
from carrl.log.mcap_read import IndexedFile, open_log
from carrl.log.mcap_records import McapIndex
from carrl.log.mcap_write import McapFile
from carrl.log.messages import Episode
from carrl.log.reader import quoted_names
from carrl.log.salvage import Content, Pieces, Place, find_pieces, lone_messages, record_at, unpacked
from carrl.log.schema import (
    CHANNELS,
    EPISODES,
    METADATA_NAME,
    METRICS,
    RECOVERY_NAME,
    TOPICS,
    TRANSITIONS,
    Schema,
    bare_schema,
)


@dataclass(frozen=True)
class Recovery:
    """What was salvaged, and what was not.

    Attributes:
        finished: whether the damaged file ended as a finished one does, with an intact summary.
        transitions: salvaged.
        episodes: salvaged.
        metrics: salvaged.
        transitions_lost: missing before or between salvaged ones; how many followed the last one nobody knows.
        episodes_lost: likewise.
        metadata_lost: whether what the log says of its run is lost.
        attachments: salvaged; none without the metadata, for nothing else tells whose they are.
        attachments_lost: those that the metadata names besides.
        chunks_lost: how many chunks that the summary tells of are not intact where it tells of them.
        messages_lost: how many messages that the summary counts were not found.
        transitions_left_out: found, but do not follow those salvaged.
        unchecked: messages salvaged that no checksum vouches for.
        runs_left_out: what else the file has something of.
        others_left_out: what is in the file and not part of a log's format.
        topics_lost: those that every log has and this one does not, or none of whose messages is left.
        episode_steps: of the salvaged episodes in all; as many transitions had a run that logged every one.
        duplicates_left_out: messages that were salvaged already.
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
    chunks_lost: int = 0
    messages_lost: int = 0
    transitions_left_out: int = 0
    unchecked: int = 0
    runs_left_out: tuple[str, ...] = ()
    others_left_out: tuple[str, ...] = ()
    topics_lost: tuple[str, ...] = ()
    episode_steps: int = 0
    duplicates_left_out: int = 0

    @property
    def complete(self) -> bool:
        """Whether the file was finished, and all that is in it is in the new log."""
        counts = (self.transitions_lost, self.episodes_lost, self.chunks_lost, self.messages_lost)
        left_out = (self.transitions_left_out, self.runs_left_out, self.others_left_out)
        lost = (self.metadata_lost, self.attachments_lost, self.topics_lost)
        return self.finished and not any((*counts, *left_out, *lost))


def recover(source: str | Path, target: str | Path, run: str | None = None) -> Recovery:
    """Writes a new, finished log of all that is intact in a damaged one, and tells what was lost.

    The target appears whole or not at all; the source is left as it is.

    Args:
        source: the damaged file.
        target: the new one.
        run: which one to salvage, in 16 hexadecimal digits; None for that with the most transitions.

    Raises:
        LogError: the source cannot be read, or has nothing of the run; the target exists or cannot be written.
        DamagedLogError: the source is empty, or no log and no piece of one.
    """
    source, target = Path(source), Path(target)
    file, _ = open_log(source)
    with file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        _check_free(target)
        index = _index_of(source)
        pieces = find_pieces(content, index)
        if not pieces.found and content[: len(MCAP0_MAGIC)] != MCAP0_MAGIC[: len(content)]:
            raise DamagedLogError(f"log '{source}': holds nothing of a CarRL log; give the train.mcap of a run")
        wanted = pieces.run if run is None else _number_of(run, pieces, source)
        partial = target.with_name(f".{uuid4().hex}.partial")
        try:
            recovery = _rewrite(content, pieces, index, wanted, partial)
            _put_into_place(partial, target)
        except FileExistsError as error:
            raise _taken(target) from error
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise _unwritable(target, error) from error
        finally:
            with suppress(OSError, ValueError):
                partial.unlink(missing_ok=True)
    return recovery


def _put_into_place(partial: Path, target: Path) -> None:
    """Gives the file its name, unless there is such a file by now; raises FileExistsError then."""
    try:
        os.link(partial, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        target.open("xb").close()
        partial.replace(target)


def _check_free(target: Path) -> None:
    try:
        target.lstat()
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        raise _unwritable(target, error) from error
    raise _taken(target)


def _taken(target: Path) -> LogError:
    return LogError(f"log '{target}': is there already; give the name of a new file")


def _number_of(run: str, pieces: Pieces, source: Path) -> int:
    names = {f"{number:016x}": number for number in pieces.runs}
    if run not in names:
        raise LogError(f"log '{source}': holds nothing of run '{run}'; it has: {quoted_names(sorted(names))}")
    return names[run]


def _unwritable(target: Path, error: Exception) -> LogError:
    reason = getattr(error, "strerror", None) or error
    return LogError(f"log '{target}': cannot be written: {reason}; give another place for it")


def _index_of(source: Path) -> McapIndex | None:
    """What the file's summary says is where in it; None if it has none that is intact."""
    with suppress(LogError), IndexedFile(source) as file:
        return None if file.grows else file.index
    return None


def _rewrite(content: Content, pieces: Pieces, index: McapIndex | None, run: int, path: Path) -> Recovery:
    """Writes the pieces of one run as a log of their own."""
    entries = pieces.metadata_of(run)
    attachments = {}
    for name, position in pieces.attachments_of(entries).items():
        record = record_at(content, position)
        assert isinstance(record, Attachment)
        attachments[name] = record.data
    named = {key.removeprefix(ATTACHMENT) for key in entries or {} if key.startswith(ATTACHMENT)}
    own = sorted(place for place in pieces.places if place.run == run)
    schema = _schema_of(content, pieces, own, entries)
    file = begin_log(path, entries or describe(run, 0, {}, attachments, schema.version), attachments, schema)
    told = {chunk.chunk_start_offset: chunk for chunk in index.chunks} if index else {}
    try:
        copy = _Copy(file, run, schema)
        for place in own:
            found = [decoded for decoded in pieces.channels.decoded(unpacked(content, place)) if decoded]
            entry = told.get(place.position)  # another chunk may have been put in its place
            is_counted = entry is not None and entry.message_start_time <= place.end_time <= entry.message_end_time
            copy.add(found, TOPICS[place.channel], is_counted)
        recovery = Recovery(
            finished=index is not None,
            transitions=copy.written[TRANSITIONS],
            episodes=copy.written[EPISODES],
            metrics=copy.written[METRICS],
            transitions_lost=copy.transitions_lost,
            episodes_lost=copy.episodes_lost,
            metadata_lost=entries is None,
            attachments=tuple(attachments),
            attachments_lost=tuple(sorted(named - attachments.keys())),
            chunks_lost=len(told.keys() - index.stretches - pieces.chunks) if index else 0,
            messages_lost=copy.lost_of(_expected(index, run)),
            transitions_left_out=copy.transitions_left_out,
            unchecked=pieces.unchecked,
            runs_left_out=tuple(f"{other:016x}" for other in sorted(pieces.runs - {run})),
            others_left_out=tuple(_others(content, pieces, index)),
            topics_lost=_topics_lost(index, entries, copy.written),
            episode_steps=copy.episode_steps,
            duplicates_left_out=copy.duplicates,
        )
        file.add_metadata(RECOVERY_NAME, {key: json.dumps(value) for key, value in asdict(recovery).items()})
        file.finish()
    finally:
        file.close()
    return recovery


def _schema_of(content: Content, pieces: Pieces, own: list[Place], entries: Mapping[str, str] | None) -> Schema:
    """The columns of a run: those of its first transitions, or else what may be known without any."""
    for place in own:
        if TOPICS[place.channel] == TRANSITIONS:
            for decoded in pieces.channels.decoded(unpacked(content, place)):
                if decoded and decoded.batch and decoded.run == place.run:
                    return decoded.batch.schema
    if entries and entries.get("format_version") == str(version2.VERSION):
        return version2.NO_WIDTHS
    return next(iter(pieces.channels.schemas), bare_schema())


def _expected(index: McapIndex | None, run: int) -> Counter[str]:
    """How many messages of the run the file's statistics count, by topic."""
    expected: Counter[str] = Counter()
    name = f"{run:016x}"
    for number, channel in index.channels.items() if index else ():
        if channel.topic in CHANNELS and channel.metadata.get("run", name) == name:
            expected[channel.topic] += index.messages[number] if index else 0
    return expected


def _topics_lost(index: McapIndex | None, entries: Mapping[str, str] | None, written: Counter[str]) -> tuple[str, ...]:
    """The topics that a finished file lacks, and that of transitions where episodes ended and not one is left.

    Only in the first part of a run no episode ends before a transition is logged.
    """
    topics = {channel.topic for channel in index.channels.values()} if index else set(CHANNELS)
    is_first = entries is not None and entries["part"] == "0"
    if is_first and written[EPISODES] and not written[TRANSITIONS]:
        topics.discard(TRANSITIONS)
    return tuple(topic for topic in CHANNELS if topic not in topics)


def _others(content: Content, pieces: Pieces, index: McapIndex | None) -> Iterator[str]:
    """What is in the file and not part of a log's format, in words."""
    if index is None:
        if count := lone_messages(content):
            yield f"{count} messages outside of chunks, for which no checksum vouches"
        return
    for number, channel in index.channels.items():
        if channel.topic not in CHANNELS and index.messages[number]:
            yield f"topic {channel.topic!r:.80}"
    for name in sorted({entry.name for entry in index.metadata} - {METADATA_NAME, RECOVERY_NAME}):
        yield f"metadata {name!r:.80}"
    vouched = {key.removeprefix(ATTACHMENT) for entries in pieces.metadata for key in entries}
    for name in sorted({entry.name for entry in index.attachments} - vouched):
        yield f"attachment {name!r:.80}"


class _Copy:
    """The new log, to which the messages of the old one come in their order, each once.

    Attributes:
        found: messages so far, each counted once.
        counted: messages so far that the file's statistics count, duplicates among them.
        duplicates: messages that were there before.
        written: transitions, and messages of the other topics.
        episode_steps: of the episodes so far.
        transitions_lost: missing so far.
        transitions_left_out: that did not fit those before.
    """

    def __init__(self, file: McapFile, run: int, schema: Schema) -> None:
        self._file, self._run, self._schema = file, run, schema
        self._chunk_beginning = chunk_beginning(f"{run:016x}", schema)
        self.found: Counter[str] = Counter()
        self.counted: Counter[str] = Counter()
        self.written: Counter[str] = Counter()
        self.duplicates = self.episode_steps = self.transitions_lost = self.transitions_left_out = 0
        self._next_offset = 0
        self._sequences: Counter[str] = Counter()
        self._highest: Counter[str] = Counter()
        self._seen: set[tuple[object, ...]] = set()

    @property
    def episodes_lost(self) -> int:
        return max(0, self._highest[EPISODES] - self.written[EPISODES])

    def lost_of(self, expected: Counter[str]) -> int:
        """How many of so many messages of each topic were not found."""
        return sum(max(0, count - max(self.found[topic], self.counted[topic])) for topic, count in expected.items())

    def add(self, found: Iterable[Decoded], topic: str, is_counted: bool) -> None:
        """Appends what is of the topic; its statistics count what is in a chunk that the file's index tells of."""
        own = [decoded for decoded in found if (decoded.run, decoded.topic) == (self._run, topic)]
        self.counted[topic] += len(own) if is_counted else 0
        own.sort(key=lambda decoded: decoded.batch.offset if decoded.batch else 0)  # a chunk may have them in any order
        messages = [message for decoded in own if (message := self._renumbered(decoded))]
        if messages:
            self._file.add_chunk(messages, self._chunk_beginning if topic == TRANSITIONS else b"")

    def _renumbered(self, decoded: Decoded) -> Message | None:
        """The message as it is to be written; None if it has been already, or does not fit those before."""
        message, topic, batch = decoded.message, decoded.topic, decoded.batch
        identity = _identity(decoded)
        if identity in self._seen:
            self.duplicates += 1
            return None
        self._seen.add(identity)
        self.found[topic] += 1
        content = message.data
        if batch is None:
            self._highest[topic] = max(self._highest[topic], message.sequence + 1)
            self.written[topic] += 1
            self.episode_steps += decoded.small.length if isinstance(decoded.small, Episode) else 0
        else:
            if batch.offset < self._next_offset or batch.schema != self._schema:
                self.transitions_left_out += batch.count
                return None
            self.transitions_lost += batch.offset - self._next_offset
            self._next_offset = batch.offset + batch.count
            content = replace(batch, offset=self.written[topic]).encode()
            self.written[topic] += batch.count
        sequence = self._sequences[topic]
        self._sequences[topic] += 1
        return replace(message, channel_id=CHANNELS[topic], data=content, sequence=sequence % 2**32)


def _identity(decoded: Decoded) -> tuple[object, ...]:
    """What tells a message from others of its run; not its sequence, for which many writers put 0."""
    content = decoded.message.data
    if decoded.batch:  # most of a log: a checksum and the place are enough, and quick
        return decoded.number, decoded.message.log_time, zlib.crc32(content)
    from hashlib import blake2b  # here, since it loads OpenSSL, which `carrl log info` need not wait for

    return decoded.topic, decoded.message.log_time, blake2b(content, digest_size=16).digest()
