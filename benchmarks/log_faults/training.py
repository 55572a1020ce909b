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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.child import BenchError, last_line
from benchmarks.log_faults.contents import message_bytes
from carrl.log.schema import METRICS

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
        folder: an empty one, for this run alone, or that of a run that is resumed.
        overrides: of Hydra.
        tear: where it kills itself.
        constants: values to give to CarRL's constants, by their full names, in this run.
        patches: asked in the run for what else to put in the place of CarRL's functions.

    Attributes:
        path: the run's own folder.
    """

    def __init__(
        self,
        folder: Path,
        overrides: Sequence[str],
        tear: Tear | None = None,
        constants: Mapping[str, Any] | None = None,
        patches: Callable[[], Iterable[Any]] = tuple,
    ) -> None:
        self._folder = folder
        self.path = run_path(folder)
        self.log = self.path / "train.mcap"
        self.started_s = time.monotonic()
        self._process = multiprocessing.get_context("fork").Process(
            target=_train, args=(folder, [*overrides, f"hydra.run.dir={self.path}"], tear, constants or {}, patches)
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

    @property
    def has_ended(self) -> bool:
        """Whether the process is gone."""
        return self._process.exitcode is not None

    def send(self, number: int) -> None:
        """Sends a signal to the run, unless it has ended."""
        if self._process.pid is not None and not self.has_ended:
            os.kill(self._process.pid, number)

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


def run_path(folder: Path) -> Path:
    """Where the run in this folder of a `TrainingRun` has its own."""
    return folder / _RUN


def preload() -> None:
    """Imports here what every run needs, so that runs need not."""
    for name in ("carrl.cli.main", "carrl.cli.train", "carrl.train.trainer"):
        importlib.import_module(name)


def _unpickled(file: Any) -> Iterator[Note]:
    with suppress(EOFError, pickle.UnpicklingError):  # the last note may be cut off
        while True:
            yield pickle.load(file)


def _train(
    folder: Path,
    overrides: list[str],
    tear: Tear | None,
    constants: Mapping[str, Any],
    patches: Callable[[], Iterable[Any]],
) -> None:
    from carrl.cli.main import main

    with ExitStack() as stack:
        console = stack.enter_context((folder / _CONSOLE).open("w", encoding="utf-8"))
        stack.enter_context(redirect_stdout(console))
        stack.enter_context(redirect_stderr(console))
        for name, value in constants.items():
            stack.enter_context(patch(name, value))
        watch = _Watch(stack.enter_context((folder / _NOTES).open("ab", buffering=0)), tear)
        for patched in (*watch.patches(), *patches()):
            stack.enter_context(patched)
        code = main(["train", *overrides])
    sys.exit(code)


class _Watch:
    """Notes what CarRL in this process is about to do, and kills the process where the tear says."""

    def __init__(self, file: Any, tear: Tear | None) -> None:
        self._file, self._tear = file, tear
        self._transitions = self._episodes = self._writes = 0
        self._closing = False

    def patches(self) -> Iterator[Any]:
        """What to put in the place of CarRL's functions: notes, then the functions themselves."""
        from carrl.data.source import EpisodeTracker
        from carrl.log import mcap_write
        from carrl.log.writer import LogWriter

        for owner, name, look in (
            (EpisodeTracker, "follow", self._see_transitions),
            (LogWriter, "write_episode", self._see_episode),
            (LogWriter, "write_metrics", self._see_metrics),
            (LogWriter, "close", self._see_closing),
            (mcap_write, "_write_at", self._see_write),
        ):
            yield patch.object(owner, name, _preceded(look, getattr(owner, name)))

    def _see_transitions(self, tracker: Any, batch: Any) -> None:
        self._transitions = tracker.frames + batch.numel()
        self._note("transitions", self._transitions)

    def _see_episode(self, _writer: Any, _episode: Any) -> None:
        self._episodes += 1
        self._note("episodes", self._episodes)

    def _see_metrics(self, _writer: Any, metrics: Any) -> None:
        self._note("metrics", message_bytes(METRICS, metrics))

    def _see_closing(self, writer: Any) -> None:
        if not writer.closed:
            self._closing = True
            self._note("close")

    def _see_write(self, descriptor: int, content: bytes, offset: int) -> None:
        self._note("write")
        tear = self._tear
        if tear and (self._closing if tear.transitions is None else self._transitions >= tear.transitions):
            if self._writes == tear.number:
                os.pwrite(descriptor, content[: round(tear.share * len(content))], offset)
                os.kill(os.getpid(), signal.SIGKILL)
            self._writes += 1

    def _note(self, kind: str, value: Any = None) -> None:
        self._file.write(pickle.dumps(Note(time.monotonic(), kind, value)))


def _preceded(look: Callable[..., None], function: Callable[..., Any]) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        look(*arguments)
        return function(*arguments)

    return call
