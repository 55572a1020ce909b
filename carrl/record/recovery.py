"""Makes a finished log of all that is intact in one that was cut off or damaged.

Indices are written anew. Pieces of other logs are told apart by the number of the run; pieces that are there twice, or
in another order, by the number of transitions before them.
"""

import json
import mmap
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from uuid import uuid4

from mcap.records import Attachment, Chunk, Message
from mcap.writer import MCAP0_MAGIC

from carrl.errors import DamagedLogError, LogError
from carrl.record.codec import row_shapes
from carrl.record.log_file import begin_log
from carrl.record.mcap_file import McapFile
from carrl.record.mcap_index import IndexedFile, open_log
from carrl.record.metadata import ATTACHMENT, describe
from carrl.record.salvage import TOPICS, Content, Decoded, Pieces, decoded_messages, find_pieces, record_at
from carrl.record.schema import EPISODES, METRICS, RECOVERY_NAME, SMALL_MESSAGES, TRANSITIONS


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

    @property
    def complete(self) -> bool:
        """Whether the file was finished, and nothing of it is lost."""
        lost = self.transitions_lost or self.episodes_lost or self.metadata_lost or self.attachments_lost
        return self.finished and not lost and not self.chunks_lost


def recover(source: str | Path, target: str | Path) -> Recovery:
    """Writes a new, finished log of all that is intact in a damaged one, and tells what was lost.

    The target appears whole or not at all; the source is left as it is.

    Raises:
        LogError: the source cannot be read, the target exists or cannot be written.
        DamagedLogError: the source is empty, or no log and no piece of one.
    """
    source, target = Path(source), Path(target)
    file, _ = open_log(source)
    with file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        _check_free(target)
        pieces = find_pieces(content)
        if not pieces.found and content[: len(MCAP0_MAGIC)] != MCAP0_MAGIC[: len(content)]:
            raise DamagedLogError(f"log '{source}': holds nothing of a CarRL log; give the train.mcap of a run")
        partial = target.with_name(f".{uuid4().hex}.partial")
        try:
            recovery = _rewrite(content, pieces, _indexed_chunks(source), partial)
            partial.rename(target)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise _unwritable(target, error) from error
        finally:
            with suppress(OSError, ValueError):
                partial.unlink(missing_ok=True)
    return recovery


def _check_free(target: Path) -> None:
    try:
        target.lstat()
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        raise _unwritable(target, error) from error
    raise LogError(f"log '{target}': is there already; give the name of a new file")


def _unwritable(target: Path, error: Exception) -> LogError:
    reason = getattr(error, "strerror", None) or error
    return LogError(f"log '{target}': cannot be written: {reason}; give another place for it")


def _indexed_chunks(source: Path) -> set[int] | None:
    """Where the file's summary says that chunks begin; None if it has none that is intact."""
    with suppress(LogError), IndexedFile(source) as file:
        return {chunk.chunk_start_offset for chunk in file.index.chunks}
    return None


def _rewrite(content: Content, pieces: Pieces, indexed: set[int] | None, path: Path) -> Recovery:
    """Writes the pieces of one run as a log of their own."""
    run = pieces.run
    entries = pieces.metadata_of(run)
    attachments = {}
    for name, position in pieces.attachments_of(entries).items():
        record = record_at(content, position)
        assert isinstance(record, Attachment)
        attachments[name] = record.data
    named = {key.removeprefix(ATTACHMENT) for key in entries or {} if key.startswith(ATTACHMENT)}
    file = begin_log(path, entries or describe(run, 0, {}, attachments), attachments)
    try:
        copy = _Copy(file, run)
        places = sorted(place for place in pieces.places if place.run == run)
        for place in places:
            chunk = record_at(content, place.position)
            assert isinstance(chunk, Chunk)
            copy.add(chunk, TOPICS[place.channel])
        recovery = Recovery(
            finished=indexed is not None,
            transitions=copy.written[TRANSITIONS],
            episodes=copy.written[EPISODES],
            metrics=copy.written[METRICS],
            transitions_lost=copy.transitions_lost,
            episodes_lost=copy.episodes_lost,
            metadata_lost=entries is None,
            attachments=tuple(attachments),
            attachments_lost=tuple(sorted(named - attachments.keys())),
            chunks_lost=len((indexed or set()) - {place.position for place in places}),
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
        self._row_shapes: dict[str, tuple[int, ...]] | None = None
        self._sequences: Counter[str] = Counter()
        self._seen: dict[str, set[int]] = {topic: set() for topic in SMALL_MESSAGES}

    @property
    def episodes_lost(self) -> int:
        seen = self._seen[EPISODES]
        return max(seen) + 1 - len(seen) if seen else 0

    def add(self, chunk: Chunk, topic: str) -> None:
        """Appends what the chunk holds of the topic."""
        own = [found for found in decoded_messages(chunk) if found and (found.run, found.topic) == (self._run, topic)]
        messages = [message for decoded in own if (message := self._renumbered(decoded))]
        if messages:
            self._file.add_chunk(messages)

    def _renumbered(self, decoded: Decoded) -> Message | None:
        """The message as it is to be written; None if it has been already, or does not fit those before."""
        message, topic, batch = decoded.message, decoded.topic, decoded.batch
        content = message.data
        if batch is None:
            if message.sequence in self._seen[topic]:
                return None
            self._seen[topic].add(message.sequence)
            self.written[topic] += 1
        else:
            self._row_shapes = self._row_shapes or row_shapes(batch.columns)
            if batch.offset < self._next_offset or row_shapes(batch.columns) != self._row_shapes:
                return None
            self.transitions_lost += batch.offset - self._next_offset
            self._next_offset = batch.offset + batch.count
            content = replace(batch, offset=self.written[topic]).encode()
            self.written[topic] += batch.count
        sequence = self._sequences[topic]
        self._sequences[topic] += 1
        return replace(message, data=content, sequence=sequence % 2**32)
