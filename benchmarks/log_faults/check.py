"""Whether recovery, verification and the readers keep what they promise for one damaged log."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.writer import MCAP0_MAGIC

from benchmarks.log_faults.contents import LogContents, message_bytes, places_in, read_contents, rows_of
from benchmarks.log_faults.sample import Piece, Sample
from carrl.errors import DamagedLogError, LogError
from carrl.log import Recovery, recover, verify
from carrl.log.reader import Log
from carrl.log.schema import EPISODES, METRICS, TRANSITIONS

Samples = tuple[Sample, Sample]
"""The log that was damaged, and the one that slices were taken from."""


@dataclass
class Outcome:
    """What became of a damaged log.

    Attributes:
        kept: the share of the transitions of the run recovered; None where nothing was left to recover.
        metadata_lost: whether what the log says of its run is lost.
        noticed: whether verification refused the file.
        spared: whether it did not, though a byte had changed, in which nothing is said.
        recovery_s: processor time of recovery, s.
        faults: whatever is not as it should be, each as a sentence.
    """

    kept: float | None = None
    metadata_lost: bool = False
    noticed: bool = False
    spared: bool = False
    recovery_s: float = 0.0
    faults: list[str] = field(default_factory=list)


def check(damaged: bytes, samples: Samples, folder: Path) -> Outcome:
    """Recovers a file of these bytes, reads it as it is, and compares all with the logs that it was made of.

    Args:
        damaged: the file's bytes.
        samples: what it was made of.
        folder: where to write; the files there are replaced.
    """
    source, target = folder / "damaged.mcap", folder / "recovered.mcap"
    source.write_bytes(damaged)
    target.unlink(missing_ok=True)
    outcome = Outcome()
    for part in (
        lambda: _check_recovery(source, target, damaged, samples, outcome),
        lambda: _check_verification(source, damaged, samples, outcome),
        lambda: _check_readers(source, samples, outcome),
    ):
        try:
            part()
        except Exception as error:  # whatever it is, it is what this program looks for
            outcome.faults.append(f"{type(error).__name__}: {error}")
    return outcome


def _check_recovery(source: Path, target: Path, damaged: bytes, samples: Samples, outcome: Outcome) -> None:
    present = [[piece for piece in sample.pieces if piece.content in damaged] for sample in samples]
    began = time.process_time()
    try:
        recovery = recover(source, target)
    except DamagedLogError:
        if any(present) or damaged[: len(MCAP0_MAGIC)] == MCAP0_MAGIC[: len(damaged)] != b"":
            raise
        return
    outcome.recovery_s = time.process_time() - began
    verify(target)
    found = read_contents(target)
    outcome.metadata_lost = recovery.metadata_lost
    outcome.kept = 0.0
    runs = [sample.says.run for sample in samples]
    if found.run not in runs:
        if found.rows or found.episodes or found.metrics or any(_chunks(pieces) for pieces in present):
            outcome.faults.append("the run that was recovered is none of those in the file")
        return
    chosen = runs.index(found.run)
    outcome.kept = len(found.rows) / len(samples[chosen].says.rows)
    if len(found.rows) < max(map(_transitions, present)):
        outcome.faults.append("not the run was recovered that the file has most transitions of")
    outcome.faults += _differences(found, recovery, samples[chosen].says, present[chosen])


def _chunks(pieces: Sequence[Piece]) -> list[Piece]:
    return [piece for piece in pieces if piece.kind == "chunk"]


def _transitions(pieces: Sequence[Piece]) -> int:
    return sum(len(piece.holds.get(TRANSITIONS, ())) for piece in pieces)


def _differences(
    found: LogContents, recovery: Recovery, original: LogContents, present: Sequence[Piece]
) -> Iterator[str]:
    """Sentences on what was invented, or lost in spite of being there, or not reported."""
    for topic, own, whole, counted in (
        (TRANSITIONS, found.rows, original.rows, (recovery.transitions, recovery.transitions_lost)),
        (EPISODES, found.episodes, original.episodes, (recovery.episodes, recovery.episodes_lost)),
        (METRICS, found.metrics, original.metrics, (recovery.metrics, None)),
    ):
        places = places_in(whole, own)
        if places is None:
            yield f"{topic} has what was never written, or not in its order, or more than once"
            continue
        if not set(places).issuperset(place for piece in present for place in piece.holds.get(topic, ())):
            yield f"{topic} lacks what is in an undamaged chunk"
        known_lost = max(places, default=-1) + 1 - len(places)
        if counted != (len(own), None if counted[1] is None else known_lost):
            yield f"{topic}: recovery tells of {counted}, not of {(len(own), known_lost)}"
    yield from _differences_of_the_rest(found, recovery, original, present)


def _differences_of_the_rest(
    found: LogContents, recovery: Recovery, original: LogContents, present: Sequence[Piece]
) -> Iterator[str]:
    attached = {name: original.attachments.get(name) for name in found.attachments}
    if attached != found.attachments:
        yield "an attachment is another one"
    if not recovery.metadata_lost and found.metadata != original.metadata:
        yield "the metadata are others"
    if any(piece.kind == "metadata" for piece in present):
        if recovery.metadata_lost:
            yield "the metadata are lost, though undamaged"
        undamaged = {piece.name for piece in present if piece.kind == "attachment"}
        if not undamaged <= found.attachments.keys():
            yield "an attachment is lost, though undamaged"
        if set(recovery.attachments_lost) != original.attachments.keys() - found.attachments.keys():
            yield f"recovery tells of {recovery.attachments_lost} as the attachments lost"
    everything = (found.rows, found.episodes, found.metrics, found.attachments, found.metadata)
    whole = (original.rows, original.episodes, original.metrics, original.attachments, original.metadata)
    if recovery.complete and everything != whole:
        yield "recovery claims to be complete, but something is lost"


def _check_verification(source: Path, damaged: bytes, samples: Samples, outcome: Outcome) -> None:
    try:
        verify(source)
    except DamagedLogError:
        outcome.noticed = True
    else:
        if damaged not in [sample.content for sample in samples]:
            outcome.spared = True
            if read_contents(source) not in [sample.says for sample in samples]:
                outcome.faults.append("verification passes a log that says something else")


def _check_readers(source: Path, samples: Samples, outcome: Outcome) -> None:
    """Reads the damaged file itself: what comes out must be what one of the logs says, or an error."""
    answers = {name: answer for name, read in READERS.items() if (answer := _answer(source, read)) is not None}
    if not any(all(answer == wanted[name] for name, answer in answers.items()) for wanted in map(_wanted, samples)):
        outcome.faults.append(f"a reader returns what was never written: one of {', '.join(answers)}")


def _answer(source: Path, read: Callable[[Log], Any]) -> Any:
    try:
        with Log(source) as log:
            return read(log)
    except LogError:
        return None


READERS: dict[str, Callable[[Log], Any]] = {
    "transitions": lambda log: rows_of(log.columns()),
    "episodes": lambda log: [message_bytes(EPISODES, episode) for episode in log.episodes()],
    "metrics": lambda log: [message_bytes(METRICS, metrics) for metrics in log.metrics()],
    "metadata": lambda log: dict(log.metadata),
    "number of transitions": lambda log: log.transitions,
    "config.yaml": lambda log: log.attachment("config.yaml"),
    "track.json": lambda log: log.attachment("track.json"),
}
"""Ways to read a log."""


def _wanted(sample: Sample) -> dict[str, Any]:
    says = sample.says
    return {
        "transitions": says.rows,
        "episodes": says.episodes,
        "metrics": says.metrics,
        "metadata": says.metadata,
        "number of transitions": len(says.rows),
        **says.attachments,
    }
