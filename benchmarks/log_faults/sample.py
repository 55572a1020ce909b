"""A log to damage, and the pieces that it consists of."""

import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.records import ChunkIndex

from benchmarks.child import BenchError
from benchmarks.log_faults.contents import LogContents, read_contents
from benchmarks.log_faults.training import TrainingRun
from carrl.log.codec import Batch
from carrl.log.mcap_read import IndexedFile
from carrl.log.reader import Log
from carrl.log.schema import CHANNELS, TRANSITIONS, Schema

_SMALL_CHUNKS = {"carrl.train.callbacks.LOGGED_TOGETHER": 96, "carrl.log.writer.FLUSH_INTERVAL_S": 0.0}
"""Constants with which even a short run's log has many chunks."""
_TOPICS = {number: topic for topic, number in CHANNELS.items()}


@dataclass(frozen=True)
class Piece:
    """A record that is recovered as a whole or not at all.

    Attributes:
        begin: of the record in the file.
        content: the record's bytes.
        kind: "metadata", "attachment" or "chunk".
        name: an attachment's.
        holds: for each topic, which of its items a chunk has, counted from 0.
    """

    begin: int
    content: bytes
    kind: str
    name: str
    holds: dict[str, range]


@dataclass(frozen=True)
class Sample:
    """A finished log.

    Attributes:
        content: the file's bytes.
        says: what it says.
        pieces: in the order of the file.
    """

    content: bytes
    says: LogContents
    pieces: list[Piece]

    @property
    def boundaries(self) -> list[int]:
        """Where pieces begin and end, and where the file does."""
        ends = [piece.begin + len(piece.content) for piece in self.pieces]
        return sorted({0, *(piece.begin for piece in self.pieces), *ends, len(self.content)})


def train_sample(experiment: str, seed: int, frames: int) -> Sample:
    """The log of a short training run.

    Raises:
        BenchError: the run failed.
    """
    overrides = [f"experiment={experiment}", f"seed={seed}", f"trainer.frames={frames}"]
    with tempfile.TemporaryDirectory() as folder:
        run = TrainingRun(Path(folder), overrides, constants=_SMALL_CHUNKS)
        if run.wait() != 0:
            raise BenchError(f"`carrl train {' '.join(overrides)}` failed: {run.last_words}")
        return read_sample(run.log)


def read_sample(path: Path) -> Sample:
    """A log and its pieces.

    Raises:
        LogError: it is not an intact log.
    """
    with Log(path) as log:
        schema = log.file_schema
    with IndexedFile(path) as file:
        content = path.read_bytes()
        pieces = []
        for metadata in file.index.metadata:
            pieces.append(_piece(content, metadata.offset, metadata.length, "metadata"))
        for attachment in file.index.attachments:
            pieces.append(_piece(content, attachment.offset, attachment.length, "attachment", attachment.name))
        pieces += _chunks(file, content, schema)
    return Sample(content, read_contents(path), pieces)


def _piece(content: bytes, begin: int, length: int, kind: str, name: str = "") -> Piece:
    return Piece(begin, content[begin : begin + length], kind, name, {})


def _chunks(file: IndexedFile, content: bytes, schema: Schema) -> Iterator[Piece]:
    before: Counter[str] = Counter()
    for entry in file.index.chunks:
        within = _count(file, entry, schema)
        record = content[entry.chunk_start_offset :][: entry.chunk_length]
        holds = {topic: range(before[topic], before[topic] + count) for topic, count in within.items()}
        yield Piece(entry.chunk_start_offset, record, "chunk", "", holds)
        before += within


def _count(file: IndexedFile, entry: ChunkIndex, schema: Schema) -> Counter[str]:
    """How many items of each topic a chunk has."""
    counts: Counter[str] = Counter()
    for message in file.messages(entry):
        topic = _TOPICS[message.channel_id]
        counts[topic] += Batch.decode(message.data, schema).count if topic == TRANSITIONS else 1
    return counts
