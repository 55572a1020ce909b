"""A run's folder while the run is in progress, and its tables, CSV files that grow row by row."""

import csv
import json
import logging
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tensordict import TensorDictBase

from carrl.errors import CarrlError, CheckpointError
from carrl.files import open_itself, remove_left_overs, write_whole
from carrl.log.messages import Episode, Metrics
from carrl.log.writer import LogWriter
from carrl.train.checkpoint import save_checkpoint
from carrl.train.files import CONFIG, EVALUATIONS, METRICS, SUMMARY, checkpoint_path, write_text
from carrl.train.learner import DIVERGENCE
from carrl.train.scalars import Scalars

_logger = logging.getLogger(__name__)
EPISODE_FIGURES = ("episode", "frame", "env", "episode_return", "length", "gates", "laps", "ended")
"""What `metrics.csv` tells of an episode."""


def check_tables(path: Path, state: Mapping[str, Any]) -> None:
    """Checks that the tables in a run's folder say what they said at this state, before anything is written.

    Raises:
        CarrlError: one says otherwise, or cannot be read.
    """
    for name in (METRICS, EVALUATIONS):
        try:
            check_table(path / name, state["tables"][name])
        except OSError as error:
            raise CheckpointError(f"'{path / name}' cannot be read: {error.strerror}; move it away") from error


class RunFolder:
    """The folder of a run in progress; use it in a `with` statement, so that its files are completed.

    Args:
        path: of the folder.
        recorder: of the run's log, if it has one.
        state: `state_dict` of the folder of a run that was broken off, to go on with it from there.
        scalars: takes the figures of the tables, too.

    Raises:
        CarrlError: the folder cannot be written.
    """

    def __init__(
        self,
        path: Path,
        recorder: LogWriter | None = None,
        state: Mapping[str, Any] | None = None,
        scalars: Scalars | None = None,
    ) -> None:
        """Opens the tables."""
        self.path = path
        self._recorder, self._scalars = recorder, scalars
        remove_left_overs(path, path / "checkpoints", (path / CONFIG).parent)
        tables = state["tables"] if state else {METRICS: "", EVALUATIONS: ""}
        self._metrics = Table(path / METRICS, tables[METRICS])
        self._evaluations = Table(path / EVALUATIONS, tables[EVALUATIONS])

    def __enter__(self) -> Self:
        """Returns the folder itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the log and the tables, also after an error."""
        self._metrics.close()
        self._evaluations.close()
        if self._scalars is not None:
            self._scalars.close()
        if self._recorder is not None:
            self._recorder.close()

    def state_dict(self) -> dict[str, Any]:
        """How far the log is written, and what the tables say.

        Raises:
            LogError: the disk fails.
        """
        return {
            "log": self._recorder.state_dict() if self._recorder else None,
            "tables": {METRICS: self._metrics.text, EVALUATIONS: self._evaluations.text},
        }

    @property
    def is_gone(self) -> bool:
        """Whether the folder was deleted or moved."""
        return not self._metrics.is_in_place

    @property
    def takes_metrics(self) -> bool:
        """Whether `add_metrics` has any use for them."""
        return self._recorder is not None or self._scalars is not None

    def record(self, transitions: TensorDictBase) -> None:
        """Logs transitions [F]."""
        if self._recorder is not None:
            self._recorder.write(transitions)

    def add_metrics(self, metrics: Metrics) -> None:
        """Logs how learning goes after the transitions logged so far."""
        if self._recorder is not None:
            self._recorder.write_metrics(metrics)
        self._add_scalars("training", metrics.frame, metrics.row())

    def flush(self) -> None:
        """Hands what was logged to the operating system, where it outlives this process."""
        if self._recorder is not None:
            self._recorder.flush()

    def add_episode(self, episode: Episode, figures: Mapping[str, Any]) -> None:
        """Logs an ended episode and adds a row to `metrics.csv`, with figures of the training beside the episode's."""
        if self._recorder is not None:
            self._recorder.write_episode(episode)
        self._metrics.append({**{name: getattr(episode, name) for name in EPISODE_FIGURES}, **figures})
        scalars = {"return": episode.episode_return, "mean_return_20": figures["mean_return_20"]}
        self._add_scalars("episode", episode.frame, scalars | {"length": episode.length, "gates": episode.gates})

    def add_learnt(self, figures: Mapping[str, Any]) -> None:
        """Adds a row to `metrics.csv` of a run without episodes."""
        self._metrics.append(
            {name: round(value, 6) if isinstance(value, float) else value for name, value in figures.items()}
        )
        self._add_scalars("training", figures["updates"], figures)

    def add_evaluation(self, measures: Mapping[str, Any], frames: int, episodes: int) -> None:
        """Adds a row to `evaluations.csv`."""
        self._evaluations.append({"frames": frames, "episodes": episodes, **measures})
        self._add_scalars("evaluation", frames, measures)

    def _add_scalars(self, group: str, step: int, values: Mapping[str, Any]) -> None:
        if self._scalars is not None:
            self._scalars.add(group, step, values)

    def save_checkpoint(self, name: str, state: Mapping[str, Any]) -> None:
        """Writes `checkpoints/NAME.pt`."""
        save_checkpoint(checkpoint_path(self.path, name), dict(state))

    def write_divergence(self, report: Mapping[str, Any]) -> None:
        """Writes `divergence.json`."""
        write_text(self.path / DIVERGENCE, json.dumps(report, indent=2) + "\n")

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Writes `summary.json`."""
        write_text(self.path / SUMMARY, json.dumps(summary, indent=2) + "\n")


def check_table(path: Path, text: str) -> int:
    """How many lines of a table's text are in its file: all of them, or the first ones only.

    Raises:
        CheckpointError: the file says otherwise, or is none.
        OSError: it cannot be read.
    """
    content = text.encode()
    found = _beginning(path, len(content))
    if not content.startswith(found):
        pairs = zip(content.splitlines(), found.splitlines(), strict=False)
        line = next(number for number, (own, other) in enumerate(pairs, start=1) if own != other)
        raise CheckpointError(
            f"'{path}': line {line} is not as the run wrote it; put it back, or move the file away, and it is written "
            "anew as it was"
        )
    return found.count(b"\n")


def _beginning(path: Path, size: int) -> bytes:
    """The first bytes of a file; none where there is no file."""
    try:
        with open(path, "rb", opener=open_itself) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise CheckpointError(f"'{path}' is not a regular file; move it away")
            return file.read(size)
    except FileNotFoundError:
        return b""


class Table:
    """A CSV file being written; its header is the first row's keys, and of the next rows only these are written.

    Args:
        path: of the file; a link in its place is not followed.
        text: all of it as it was, to go on with it from there. What follows in the file is cut off; what is missing at
            its end, or all of it, is written anew.

    Raises:
        CheckpointError: the file says otherwise than the text.
        CarrlError: the file cannot be written.
    """

    def __init__(self, path: Path, text: str = "") -> None:
        """Opens the file."""
        self._path = path
        self._writer: csv.DictWriter[str] | None = None
        self._header = next(csv.reader(text.splitlines()), [])  # an older version may have had fewer columns
        content = text.encode()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            missing = content.count(b"\n") - check_table(path, text)
            if missing:
                _logger.warning("'%s' lacked %d of its lines, which the checkpoint puts back.", path, missing)
            write_whole(path, content)
            self._file = open(path, "a+", newline="", encoding="utf-8", buffering=1, opener=open_itself)  # noqa: SIM115
        except OSError as error:
            raise self._unwritable(error) from error

    @property
    def is_in_place(self) -> bool:
        """Whether the path leads to the file that is written."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except OSError:
            return False

    @property
    def text(self) -> str:
        """All that is written so far.

        Raises:
            CarrlError: the disk refuses it.
        """
        return self._content.decode()

    @property
    def _content(self) -> bytes:
        try:
            return os.pread(self._file.fileno(), os.fstat(self._file.fileno()).st_size, 0)
        except OSError as error:
            raise self._unwritable(error) from error

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row.

        Raises:
            CarrlError: the disk refuses it.
        """
        try:
            if self._writer is None:
                self._writer = csv.DictWriter(self._file, self._header or list(row), extrasaction="ignore")
                if self._file.tell() == 0:
                    self._writer.writeheader()
            self._writer.writerow(row)
        except OSError as error:
            raise self._unwritable(error) from error

    def close(self) -> None:
        """Completes the file.

        Raises:
            CarrlError: the disk refuses it.
        """
        try:
            self._file.close()
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> CarrlError:
        return CarrlError(f"'{self._path}' cannot be written: {error.strerror}; choose another place")
