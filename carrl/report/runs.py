"""All runs below some folders, each read back from files that may be missing, half written or damaged."""

import csv
import io
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from carrl.config import MOST
from carrl.errors import CarrlError, CheckpointError, shown
from carrl.train.files import CONFIG, METRICS, SUMMARY, read_config, read_text, seed_folders
from carrl.train.trials import Trials, read_trials

Wanted = Mapping[str, tuple[type, ...]]
_COUNT, _NUMBER, _FLAG = (int,), (int, float), (bool,)
_RUN: Wanted = {"episodes": _COUNT, "frames": _COUNT, "updates": _COUNT, "wall_time_s": _NUMBER}
_FIRST_LAP: Wanted = {"episode": _COUNT, "frame": _COUNT, "wall_time_s": _NUMBER}
_EVALUATION: Wanted = {
    "lap_completed": _FLAG,
    "progress": _NUMBER,
    "lap_reward": _NUMBER,
    "lap_steps": _COUNT,
}
_TIME = (int, float, type(None))
_STYLE: Wanted = {
    "lap_time": _TIME,
    "forward_share": _NUMBER,
    "switches_per_100m": _NUMBER,
    "reversals": _COUNT,
    "mean_speed": _NUMBER,
    "steering_change": _NUMBER,
}
"""What some evaluations have, by the kind of car and of actions."""
FINISHED, INTERRUPTED, UNFINISHED, DAMAGED = "finished", "interrupted", "unfinished", "damaged"
"""How a run ended; only the finished count."""
MOST_EPISODES = 2**20
"""That are read from one `metrics.csv`."""


def read_summary(run: Path) -> dict[str, Any]:
    """What `summary.json` says of a run.

    Of its figures those that reports show are checked; `first_lap` and `evaluation` may be None.

    Raises:
        CheckpointError: the file is damaged.
    """
    try:
        summary = json.loads(read_text(run / SUMMARY), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"run '{run}': {SUMMARY} is damaged: it is not JSON") from error
    try:
        _check("it", summary, _RUN)
        for name, wanted in (("first_lap", _FIRST_LAP), ("evaluation", _EVALUATION)):
            if name not in summary:
                raise ValueError(f"it lacks {name}")
            if summary[name] is not None:
                _check(name, summary[name], wanted)
        if summary["evaluation"] is not None:
            _check("evaluation", summary["evaluation"], _styles_in(summary["evaluation"]))
    except ValueError as error:
        raise CheckpointError(f"run '{run}': {SUMMARY} is damaged: {error}") from None
    return dict(summary)


def _styles_in(evaluation: Mapping[str, Any]) -> Wanted:
    """Those of an evaluation; the three of named actions are among them if it has neither of the last two."""
    wanted = {key: kinds for key, kinds in _STYLE.items() if key in evaluation}
    by_name = {key: _STYLE[key] for key in ("forward_share", "switches_per_100m", "reversals")}
    return wanted if wanted.keys() & {"mean_speed", "steering_change"} else wanted | by_name


def missing_lap(summary: Mapping[str, Any], never: str) -> str:
    """What stands in the place of a run's first lap where it has none.

    "not confirmed" of one that did lap, `never` of one that did not, and "-" of one that learnt from logs, which is
    driven once.
    """
    if "transitions" in summary:
        return "-"
    best = summary["evaluation"]
    return "not confirmed" if best is not None and best["lap_completed"] else never


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _check(name: str, found: object, wanted: Wanted) -> None:
    if not isinstance(found, dict):
        raise ValueError(f"{name} is {shown(found)}")
    for key, kinds in wanted.items():
        value: Any = found.get(key)
        is_kind = isinstance(value, kinds) and isinstance(value, bool) == (kinds == _FLAG)
        if not is_kind or not abs(value or 0) <= 2**53:  # inf fails it
            raise ValueError(f"{name} has {shown(value)} as {key}")


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

    @cached_property
    def trials(self) -> Trials:
        """Of its networks in training; none where they cannot be read."""
        return read_trials(self.folder)

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


def find_runs(roots: list[Path]) -> list[RunResult]:
    """Every run below the folders, those in progress or broken off included, in the natural order of their paths.

    Raises:
        CheckpointError: there is none in one of them.
    """
    found = check_have_runs(roots)
    found -= {folder.parent for folder in found}  # a run of several seeds holds one folder for each
    folders = sorted(found, key=in_natural_order)
    return [read_run(folder, label) for folder, label in zip(folders, _labels(folders), strict=True)]


def check_have_runs(roots: list[Path]) -> set[Path]:
    """The folders below these that hold a configuration: those of runs, and those above of several seeds.

    Raises:
        CheckpointError: there is none in one of them.
    """
    runs = {root: {config.parent.parent for config in root.rglob(str(CONFIG))} for root in roots if os.path.isdir(root)}
    empty = [root for root in roots if not runs.get(root)]
    if empty:
        names = ", ".join(f"'{root}'" for root in empty)
        raise CheckpointError(f"no run in {names}; name folders that `carrl train` has written")
    return set().union(*runs.values())


def runs_of_sweep(folder: Path) -> list[RunResult]:
    """The runs below a folder that is no run itself, nor one of several seeds; none below any other."""
    if not os.path.isdir(folder) or os.path.lexists(folder / CONFIG) or seed_folders(folder) != [folder]:
        return []
    try:
        return find_runs([folder])
    except CheckpointError:
        return []


def in_natural_order(folder: Path) -> list[tuple[str, int]]:
    """A key that puts seed=2 before seed=10."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D*)(\d*)", str(folder))]


def _labels(folders: list[Path]) -> list[str]:
    """The parts of the folders' names in which they differ: seed=3 of seed=3,trainer.frames=100000.

    Where their own names do not tell them apart, those of the folders above them are added.
    """
    labels: list[str] = []
    for depth in range(1, max(len(folder.parts) for folder in folders) + 1):
        words = [[word for part in folder.parts[-depth:] for word in part.split(",")] for folder in folders]
        common = set.intersection(*map(set, words)) if len(folders) > 1 else set()
        labels = [",".join(word for word in own if word not in common) for own in words]
        if len(set(labels)) == len(labels):
            break
    return [label or folder.name for label, folder in zip(labels, folders, strict=True)]
