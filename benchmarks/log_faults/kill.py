"""One training run killed with kill -9, and what its log still says."""

import random
import tempfile
import time
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.child import BenchError
from benchmarks.log_faults.contents import LogContents, read_contents
from benchmarks.log_faults.sample import Piece, read_sample
from benchmarks.log_faults.training import Note, Tear, TrainingRun
from carrl.log import recover, verify
from carrl.log.log_file import CHECKSUM
from carrl.log.schema import TRANSITIONS

MOST_LOST_S = 2.0
"""What a killed run may lose of its transitions: those of so many seconds before."""
ANY_MOMENT, BEGINNING, RUNNING, CLOSING = (
    "at any moment",
    "in the middle of a write before the first step",
    "in the middle of a write",
    "in the middle of a write that closes the log",
)
MOMENTS = (ANY_MOMENT, BEGINNING, RUNNING, CLOSING)
_DURATIONS = 1.1
"""How long a run may go on before it is killed, in durations of the reference, up to its log's end."""
_OWN_ENTRIES = {"run", CHECKSUM, "git_commit"}
"""Entries of the metadata that another run with the same seed may have otherwise."""


@dataclass(frozen=True)
class Reference:
    """A run that nobody killed.

    Attributes:
        overrides: of Hydra, with the seed.
        contents: of its log.
        seconds: from its start until its log was closed, where nothing else keeps the processor busy.
        writes: to the log before the first transition.
        closing_writes: to the log while it was closed.
        longest_wait_s: from the making of a transition to the write that took it to the log, s.
    """

    overrides: Sequence[str]
    contents: LogContents
    seconds: float
    writes: int
    closing_writes: int
    longest_wait_s: float


@dataclass
class Kill:
    """What a killed run left.

    Attributes:
        moment: one of `MOMENTS`.
        state: of the log: "none", "unfinished" or "finished".
        transitions: that the run had made.
        lost_s: of what was done, the age of the oldest that is lost when the run was killed, by kind: "transitions",
            "episodes" and "metrics"; 0 if nothing is.
        lost: how many are.
        recovery_s: seconds that recovery took.
        faults: whatever is not as it should be, each as a sentence.
    """

    moment: str
    state: str = "none"
    transitions: int = 0
    lost_s: dict[str, float] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    recovery_s: float = 0.0
    faults: list[str] = field(default_factory=list)


def run_to_the_end(overrides: Sequence[str]) -> Reference:
    """Trains without a kill.

    Raises:
        BenchError: the run failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        run = TrainingRun(Path(folder), overrides)
        if run.wait() != 0:
            raise BenchError(f"`carrl train {' '.join(overrides)}` failed: {run.last_words}")
        if not run.log.exists():
            raise BenchError(
                f"`carrl train {' '.join(overrides)}` leaves no {run.log.name}; train one replicate, with a log"
            )
        verify(run.log)
        notes = run.notes
        kinds = [note.kind for note in notes]
        writes = kinds[: kinds.index("transitions")].count("write")
        closing_writes = kinds[kinds.index("close") :].count("write")
        sample = read_sample(run.log)
        wait_s = longest_wait(notes, sample.pieces)
        return Reference(overrides, sample.says, notes[-1].time_s - run.started_s, writes, closing_writes, wait_s)


def longest_wait(notes: Sequence[Note], pieces: Sequence[Piece]) -> float:
    """The longest that a transition waited for the write that took it to the log, s."""
    chunks = [piece for piece in pieces if piece.kind == "chunk"]
    writes = [note.time_s for note in notes if note.kind == "write"][-len(chunks) - 1 : -1]  # the last: the summary
    made = [note for note in notes if note.kind == "transitions"]
    firsts = [(written_s, chunk.holds.get(TRANSITIONS)) for written_s, chunk in zip(writes, chunks, strict=True)]
    return max(
        written_s - made[bisect_right(made, first.start, key=lambda note: note.value)].time_s
        for written_s, first in firsts
        if first
    )


def kill_one(reference: Reference, moment: str, draw: random.Random) -> Kill:
    """Starts the same run again, kills it, and compares what is recovered with the reference."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = TrainingRun(folder, reference.overrides, _draw_tear(reference, moment, draw))
        if moment == ANY_MOMENT:
            killed_s = run.kill_after(draw.uniform(0.0, _DURATIONS * reference.seconds))
        else:
            run.wait()
            killed_s = run.notes[-1].time_s
        kill = Kill(moment)
        if run.log.exists() and run.log.stat().st_size:
            kill.state = "finished" if _is_finished(run.log) else "unfinished"
            _recover(run.log, folder / "recovered.mcap", kill)
            if not kill.faults:
                _compare(read_contents(folder / "recovered.mcap"), reference.contents, run.notes, killed_s, kill)
        return kill


def _draw_tear(reference: Reference, moment: str, draw: random.Random) -> Tear | None:
    if moment == ANY_MOMENT:
        return None
    share = draw.random()
    if moment == BEGINNING:
        return Tear(0, draw.randrange(reference.writes), share)
    if moment == CLOSING:
        return Tear(None, draw.randrange(reference.closing_writes), share)
    return Tear(draw.randrange(1, len(reference.contents.rows)), draw.randrange(2), share)


def _is_finished(log: Path) -> bool:
    try:
        verify(log)
    except Exception:
        return False
    return True


def _recover(log: Path, target: Path, kill: Kill) -> None:
    began = time.perf_counter()
    try:
        recover(log, target)
        kill.recovery_s = time.perf_counter() - began
        verify(target)
    except Exception as error:  # whatever it is, it is what this program looks for
        kill.faults.append(f"recovery failed: {type(error).__name__}: {error}")


def _compare(found: LogContents, expected: LogContents, notes: Sequence[Note], killed_s: float, kill: Kill) -> None:
    """Notes what is lost, and whatever was never written."""
    kill.transitions = max((note.value for note in notes if note.kind == "transitions"), default=0)
    handed_over = [note.value for note in notes if note.kind == "metrics"]
    for kind, own, whole in (
        ("transitions", found.rows, expected.rows),
        ("episodes", found.episodes, expected.episodes),
        ("metrics", found.metrics, handed_over),
    ):
        if own != whole[: len(own)]:
            kill.faults.append(f"the {len(own)} recovered {kind} are not the first ones that the run made")
        kill.lost[kind], kill.lost_s[kind] = _loss(kind, len(own), notes, killed_s)
    if kill.lost_s["transitions"] > MOST_LOST_S:
        kill.faults.append(f"transitions made {kill.lost_s['transitions']:.3f} s before the kill are lost")
    if {name: expected.attachments.get(name) for name in found.attachments} != found.attachments:
        kill.faults.append("an attachment is another one")
    if found.rows:
        if found.attachments != expected.attachments:
            kill.faults.append("an attachment is lost, though it was written before the first transition")
        if common_entries(found) != common_entries(expected):
            kill.faults.append("the metadata are others")


def _loss(kind: str, recovered: int, notes: Sequence[Note], killed_s: float) -> tuple[int, float]:
    """How many are lost, and how long before the kill the first of them was made."""
    made = [note for note in notes if note.kind == kind]
    counts = [index if kind == "metrics" else note.value for index, note in enumerate(made, start=1)]
    times = [note.time_s for note, count in zip(made, counts, strict=True) if count > recovered]
    if not times:
        return 0, 0.0
    return counts[-1] - recovered, max(0.0, killed_s - times[0])


def common_entries(contents: LogContents) -> dict[str, str]:
    """The metadata that every run with the same seed has."""
    return {key: value for key, value in contents.metadata.items() if key not in _OWN_ENTRIES}
