"""One run's folder, read back as files that may be missing, half written or damaged."""

import csv
import io
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from carrl.config import MOST
from carrl.errors import CarrlError, CheckpointError
from carrl.report.summary_file import read_summary
from carrl.train.files import CONFIG, METRICS, SUMMARY, read_config, read_text

FINISHED, INTERRUPTED, UNFINISHED, DAMAGED = "finished", "interrupted", "unfinished", "damaged"
"""How a run ended; only the finished count."""
MOST_EPISODES = 2**20
"""That are read from one `metrics.csv`."""


@dataclass(frozen=True)
class EpisodeEnds:
    """What `metrics.csv` tells of each ended episode, in order.

    Attributes:
        frames: env steps of the run by then, [E].
        returns: of the episode, [E].
        mean_returns: of the last 20 episodes, [E].
    """

    frames: tuple[int, ...] = ()
    returns: tuple[float, ...] = ()
    mean_returns: tuple[float, ...] = ()


@dataclass(frozen=True)
class RunResult:
    """One run's folder, read back.

    Attributes:
        label: short name that tells it from the others of the report.
        folder: the run's.
        config: the resolved configuration; empty where it cannot be read.
        summary: what `summary.json` holds; None where there is none, or none that can be read.
        ends: of its episodes; none where it learnt from logs.
        state: `FINISHED`, `INTERRUPTED`, `UNFINISHED` or `DAMAGED`.
        reason: why it has not finished; empty if it has.
    """

    label: str
    folder: Path
    config: dict[str, Any] = field(repr=False)
    summary: dict[str, Any] | None = field(repr=False)
    ends: EpisodeEnds = field(repr=False)
    state: str
    reason: str

    @property
    def episode_returns(self) -> tuple[float, ...]:
        """Of every ended episode, in order."""
        return self.ends.returns

    @property
    def counts(self) -> bool:
        """Whether it has finished as planned, so that its figures can be compared."""
        return self.state == FINISHED

    @property
    def learnt_from_logs(self) -> bool:
        """Whether it never drove while it learnt."""
        return "transitions" in (self.summary or {})

    @cached_property
    def trained_with_others(self) -> bool:
        """Whether it is one of several seeds that were trained at once, in one process."""
        return (self.folder.parent / CONFIG).exists()

    @cached_property
    def seed(self) -> int | None:
        """Of everything random in the run; None where the configuration does not say."""
        seed = self.config.get("seed")
        return seed if isinstance(seed, int) else None


def read_run(folder: Path, label: str) -> RunResult:
    """A run as far as it can be read; what cannot be is its `reason`, no error."""
    config: dict[str, Any] = {}
    try:
        config = read_config(folder)
    except CarrlError as error:
        reason = _without_folder(error, folder)
        state = DAMAGED if (folder / SUMMARY).exists() else UNFINISHED
        return RunResult(label, folder, config, None, EpisodeEnds(), state, reason)
    if not (folder / SUMMARY).exists():
        ends = _read_ends(folder, forgiving=True)
        return RunResult(label, folder, config, None, ends, UNFINISHED, _how_far(ends))
    try:
        summary = read_summary(folder)
        ends = EpisodeEnds() if "transitions" in summary else _read_ends(folder)
    except CarrlError as error:
        return RunResult(label, folder, config, None, EpisodeEnds(), DAMAGED, _without_folder(error, folder))
    reason = _what_is_left(config, summary)
    return RunResult(label, folder, config, summary, ends, INTERRUPTED if reason else FINISHED, reason)


def _without_folder(error: CarrlError, folder: Path) -> str:
    """The error's reason; the folder is named beside it."""
    return str(error).removeprefix(f"run '{folder}': ").replace(f"'{folder}/", "'")


def _how_far(ends: EpisodeEnds) -> str:
    reached = f"its last episode ended at frame {ends.frames[-1]:,}" if ends.frames else "no episode has ended"
    return f"no {SUMMARY}, so it crashed, was killed, or still runs; {reached}"


def _what_is_left(config: dict[str, Any], summary: dict[str, Any]) -> str:
    """What a run that was stopped early had still to do; empty for one that did what it was asked to."""
    trainer, offline = (config.get(group) or {} for group in ("trainer", "data"))
    if "transitions" in summary:
        planned = offline.get("updates")
        left = isinstance(planned, int) and summary["updates"] < planned
        return f"stopped after {summary['updates']:,} of {planned:,} updates" if left else ""
    frames, episodes = trainer.get("frames"), trainer.get("episodes")
    if not isinstance(frames, int) or not isinstance(episodes, int):
        return ""
    if summary["frames"] >= frames or summary["episodes"] >= episodes:
        return ""
    done = f"{summary['frames']:,} of {frames:,} frames and {summary['episodes']:,} of {episodes:,} episodes"
    return f"stopped after {done}"


def _read_ends(folder: Path, forgiving: bool = False) -> EpisodeEnds:
    """What `metrics.csv` tells; nothing where there is none.

    Args:
        folder: the run's.
        forgiving: stop before a row that is damaged, as the last one of a run that was killed may be.

    Raises:
        CheckpointError: a row is damaged.
    """
    if not (folder / METRICS).exists():
        return EpisodeEnds()
    rows: list[tuple[int, float, float]] = []
    try:
        text = read_text(folder / METRICS)
    except CarrlError:
        if forgiving:
            return EpisodeEnds()
        raise
    try:
        for row in csv.DictReader(io.StringIO(text, newline="")):
            figures = (int(row["frame"]), float(row["episode_return"]), float(row["mean_return_20"]))
            if not all(abs(figure) <= MOST for figure in figures) or len(rows) >= MOST_EPISODES:
                raise ValueError("no number or too large a one, or too many")
            rows.append(figures)
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        if not forgiving:
            place = f"row {len(rows) + 2} has no frame, episode_return and mean_return_20"
            raise CheckpointError(f"{METRICS} is damaged: {place}") from error
    return EpisodeEnds(*zip(*rows, strict=True)) if rows else EpisodeEnds()
