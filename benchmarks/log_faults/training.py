"""Training runs in processes of their own, watched from outside, that end by themselves or by kill -9.

A run is forked from this process and is `carrl train` itself, with notes taken of what it has done so far. The notes go
straight to the operating system, which keeps them when the run is killed.
"""

import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.child import BenchError, last_line
from benchmarks.log_faults.contents import message_bytes
from carrl.record.schema import METRICS

LONGEST_RUN_S = 1800.0
_RUN, _NOTES, _CONSOLE = "run", "notes", "console.txt"


@dataclass(frozen=True)
class Note:
    """What a run was about to do.

    Attributes:
        time_s: when, on this machine's monotonic clock.
        kind: "transitions", "episodes", "metrics", "write" or "close".
        value: of transitions and episodes, how many there are now; of metrics, the message's bytes; else nothing.
    """

    time_s: float
    kind: str
    value: Any = None


@dataclass(frozen=True)
class Tear:
    """A write to the log in the middle of which the run kills itself.

    Attributes:
        transitions: made before; None: until the log is being closed.
        number: of the write among those after that, from 0.
        share: of the write's bytes that are written, 0 to 1.
    """

    transitions: int | None
    number: int
    share: float


class TrainingRun:
    """A run of `carrl train`; it begins at once.

    Args:
        folder: an empty one, for this run alone.
        overrides: of Hydra.
        tear: where it kills itself.
        constants: values to give to CarRL's constants, by their full names, in this run.
    """

    def __init__(
        self,
        folder: Path,
        overrides: Sequence[str],
        tear: Tear | None = None,
        constants: Mapping[str, Any] | None = None,
    ) -> None:
        self._folder = folder
        self.log = folder / _RUN / "train.mcap"
        self.started_s = time.monotonic()
        self._process = multiprocessing.get_context("fork").Process(
            target=_train, args=(folder, [*overrides, f"hydra.run.dir={folder / _RUN}"], tear, constants or {})
        )
        self._process.daemon = True
        self._process.start()

    def kill_after(self, seconds: float) -> float:
        """Kills the run so many seconds after its start, or lets it end by itself before, and tells when that was."""
        self._process.join(max(0.0, self.started_s + seconds - time.monotonic()))
        killed_s = time.monotonic()
        self._process.kill()
        self._process.join()
        return killed_s

    def wait(self) -> int:
        """Waits until the run has ended, and returns its exit code, below 0 for a signal.

        Raises:
            BenchError: it takes too long.
        """
        self._process.join(LONGEST_RUN_S)
        if self._process.exitcode is None:
            self._process.kill()
            raise BenchError(f"a run did not end within {LONGEST_RUN_S:.0f} s")
        return self._process.exitcode

    @property
    def last_words(self) -> str:
        """The last line that it printed."""
        console = self._folder / _CONSOLE
        return last_line(console.read_text(encoding="utf-8", errors="replace")) if console.exists() else "nothing"

    @property
    def notes(self) -> list[Note]:
        """All notes so far, in the order of time."""
        path = self._folder / _NOTES
        with path.open("rb") if path.exists() else open(os.devnull, "rb") as file:
            return list(_unpickled(file))


def preload() -> None:
    """Imports here what every run needs, so that runs need not."""
    for name in ("carrl.cli.main", "carrl.cli.train", "carrl.run.trainer"):
        importlib.import_module(name)


def _unpickled(file: Any) -> Iterator[Note]:
    with suppress(EOFError, pickle.UnpicklingError):  # the last note may be cut off
        while True:
            yield pickle.load(file)


def _train(folder: Path, overrides: list[str], tear: Tear | None, constants: Mapping[str, Any]) -> None:
    from carrl.cli.main import main

    with ExitStack() as stack:
        console = stack.enter_context((folder / _CONSOLE).open("w", encoding="utf-8"))
        stack.enter_context(redirect_stdout(console))
        stack.enter_context(redirect_stderr(console))
        notes = stack.enter_context((folder / _NOTES).open("ab", buffering=0))
        for name, value in constants.items():
            stack.enter_context(patch(name, value))
        stack.enter_context(_noting(lambda kind, value=None: _write_note(notes, kind, value), tear))
        code = main(["train", *overrides])
    sys.exit(code)


def _write_note(file: Any, kind: str, value: Any) -> None:
    file.write(pickle.dumps(Note(time.monotonic(), kind, value)))


@contextmanager
def _noting(note: Callable[..., None], tear: Tear | None) -> Iterator[None]:
    """Has CarRL tell what it is about to do, and kills it where the tear says."""
    from carrl.record import mcap_file
    from carrl.record.writer import LogWriter
    from carrl.run.trainer import Trainer

    originals = (Trainer._learn_from, LogWriter.write_episode, LogWriter.write_metrics, LogWriter.close)
    learn_from, write_episode, write_metrics, close = originals
    write_at = mcap_file._write_at
    transitions = episodes = writes = 0
    closing = False

    def noted_learn_from(self: Trainer, batch: Any) -> None:
        nonlocal transitions
        transitions = self.frames + batch.numel()
        note("transitions", transitions)
        learn_from(self, batch)

    def noted_write_episode(self: LogWriter, episode: Any) -> None:
        nonlocal episodes
        episodes += 1
        note("episodes", episodes)
        write_episode(self, episode)

    def noted_write_metrics(self: LogWriter, metrics: Any) -> None:
        note("metrics", message_bytes(METRICS, metrics))
        write_metrics(self, metrics)

    def noted_close(self: LogWriter) -> None:
        nonlocal closing
        if not self.closed:
            note("close")
            closing = True
        close(self)

    def noted_write_at(descriptor: int, content: bytes, offset: int) -> None:
        nonlocal writes
        note("write")
        if tear and (closing if tear.transitions is None else transitions >= tear.transitions):
            if writes == tear.number:
                os.pwrite(descriptor, content[: round(tear.share * len(content))], offset)
                os.kill(os.getpid(), signal.SIGKILL)
            writes += 1
        write_at(descriptor, content, offset)

    with (
        patch.object(Trainer, "_learn_from", noted_learn_from),
        patch.object(LogWriter, "write_episode", noted_write_episode),
        patch.object(LogWriter, "write_metrics", noted_write_metrics),
        patch.object(LogWriter, "close", noted_close),
        patch.object(mcap_file, "_write_at", noted_write_at),
    ):
        yield
