"""What a run shows on the terminal: its progress, and a table at the end."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from carrl.cli.text.terminal_table import print_table
from carrl.printable import printable
from carrl.report.summary_file import missing_lap
from carrl.train.agent_run import RECENT_EPISODES
from carrl.train.offline_trainer import OfflineTrainer
from carrl.train.trainer import Trainer

T = TypeVar("T")


class Display(ABC, Generic[T]):
    """A live progress bar with figures below it; use it in a `with` statement and call it after every round."""

    def __init__(self) -> None:
        """Shows nothing before the first round."""
        self._bar = Progress(SpinnerColumn(), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._task = self._bar.add_task("", total=1.0)
        self._figures = Text()
        self._console = Console(stderr=True)
        self._live = Live(Group(self._bar, self._figures), console=self._console, refresh_per_second=4)

    def __enter__(self) -> Self:
        """Begins to draw."""
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leaves the last state on the screen."""
        self._live.stop()
        if not self._console.is_terminal:  # where rich leaves out the last line's end
            self._console.print()

    def __call__(self, trainer: T) -> None:
        """Moves the bar and the figures on."""
        self._bar.update(self._task, completed=min(self.done(trainer), 1.0))
        self._figures.plain = self.figures(trainer)

    @abstractmethod
    def done(self, trainer: T) -> float:
        """The share of the training that is done; 1 or more at its end."""

    @abstractmethod
    def figures(self, trainer: T) -> str:
        """How it goes, in two lines."""


class Silence:
    """Shows nothing, where many runs share a terminal; used as a `Display` is."""

    def __enter__(self) -> Self:
        """Does nothing."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Does nothing."""

    def __call__(self, trainer: Any) -> None:
        """Does nothing."""


class TrainingDisplay(Display[Trainer]):
    """Shows how training in the simulator goes."""

    def __init__(self, frames_limit: int, episodes_limit: int) -> None:
        super().__init__()
        self._frames_limit, self._episodes_limit = frames_limit, episodes_limit

    def done(self, trainer: Trainer) -> float:
        """By env steps or episodes, whichever limit is nearer."""
        episodes = min(run.episodes for run in trainer.runs)  # the run that ends last
        return max(trainer.frames / self._frames_limit, episodes / self._episodes_limit)

    def figures(self, trainer: Trainer) -> str:
        """Env steps, episodes, laps and returns."""
        runs = trainer.runs
        recent = [run.recent_return for run in runs if not math.isnan(run.recent_return)]
        mean_return = sum(recent) / len(recent) if recent else math.nan
        rate = sum(run.moment.frames for run in runs) / max(trainer.wall_time_s, 1e-9)
        return (
            f"  {trainer.frames:,} frames · {sum(run.episodes for run in runs):,} episodes · "
            f"{sum(run.laps for run in runs):,} laps · {rate:,.0f} frames/s\n"
            f"  return of the last {RECENT_EPISODES} episodes {mean_return:.0f} · "
            f"epsilon {runs[0].moment.epsilon:.2f} · {_laps_so_far(trainer)}"
        )


class OfflineDisplay(Display[OfflineTrainer]):
    """Shows how learning from logs goes."""

    def __init__(self, updates_limit: int, transitions: int) -> None:
        super().__init__()
        self._updates_limit, self._transitions = updates_limit, transitions

    def done(self, trainer: OfflineTrainer) -> float:
        """By updates."""
        return trainer.updates / self._updates_limit

    def figures(self, trainer: OfflineTrainer) -> str:
        """Updates, and the loss of the agents' last minibatches."""
        agents = len(trainer.runs)
        rate = trainer.updates * agents / max(trainer.wall_time_s, 1e-9)
        loss = sum(run.moment.loss for run in trainer.runs) / agents
        each = "" if agents == 1 else f" of each of {agents} agents"
        return (
            f"  {trainer.updates:,} updates{each} · {rate:,.0f} updates/s\n"
            f"  {self._transitions:,} transitions from logs · loss {loss:.1f}"
        )


def print_summary(summary: Mapping[str, Any], folder: Path) -> None:
    """Prints the run's result as a short table."""
    title = f"seed {summary['seed']} on track {summary['track']}"
    table = Table(title=escape(printable(title)), title_justify="left")
    table.add_column("result")
    table.add_column("", justify="right")
    for name, value in _summary_rows(summary):
        table.add_row(name, value)
    console = Console()
    console.print(table)
    console.print(_place(folder), soft_wrap=True, highlight=False)


def print_summaries(summaries: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Prints a line for each of several seeds; `carrl report` has more."""
    columns = _OFFLINE_COLUMNS if _is_offline(summaries[0]) else _COLUMNS
    rows = [[value_of(summary) for value_of in columns.values()] for summary in summaries]
    print_table(f"{len(rows)} seeds on track {summaries[0]['track']}", tuple(columns), rows)
    Console().print(_place(folder), soft_wrap=True, highlight=False)


def _laps_so_far(trainer: Trainer) -> str:
    """How many agents lapped the track twice running, or on how many of several circuits their best networks did."""
    runs = trainer.runs
    trials = [run.best for run in runs if run.best is not None]
    if not trials or len(trials[0].rollouts) == 1:
        return f"first lap by {sum(run.first_lap is not None for run in runs)} of {len(runs)}"
    laps = [trial.laps_completed for trial in trials]
    each = f"{min(laps)}" if min(laps) == max(laps) else f"{min(laps)} to {max(laps)}"
    return f"lapped {each} of {len(trials[0].rollouts)}"


def _place(folder: Path) -> str:
    return escape(printable(f"results in {folder}"))


def _is_offline(summary: Mapping[str, Any]) -> bool:
    """Whether the run learnt from logs, where env steps, episodes and a first lap mean nothing."""
    return "transitions" in summary


_DRIVE_COLUMNS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "reward": lambda summary: f"{summary['evaluation']['lap_reward']:.0f}",
    "forward": lambda summary: f"{summary['evaluation']['forward_share']:.0%}",
    "switches / 100 m": lambda summary: f"{summary['evaluation']['switches_per_100m']:.1f}",
}
_COLUMNS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "seed": lambda summary: str(summary["seed"]),
    "frames": lambda summary: f"{summary['frames']:,}",
    "episodes": lambda summary: f"{summary['episodes']:,}",
    "first greedy lap": lambda summary: (
        f"{summary['first_lap']['frame']:,}" if summary["first_lap"] else missing_lap(summary, "none")
    ),
    "best greedy lap": lambda summary: _how_far(summary["evaluation"]),
    **_DRIVE_COLUMNS,
}
_OFFLINE_COLUMNS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "seed": lambda summary: str(summary["seed"]),
    "transitions": lambda summary: f"{summary['transitions']:,}",
    "updates": lambda summary: f"{summary['updates']:,}",
    "greedy lap": lambda summary: _how_far(summary["evaluation"]),
    **_DRIVE_COLUMNS,
}


def _summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    first, best = summary["first_lap"], summary["evaluation"]
    first_update = summary["first_update_s"]
    rows = [
        ("updates", f"{summary['updates']:,}"),
        ("wall time", f"{summary['wall_time_s']:.1f} s"),
        ("first update", "none" if first_update is None else f"after {first_update:.1f} s"),
    ]
    if _is_offline(summary):
        rows.insert(0, ("transitions from logs", f"{summary['transitions']:,}"))
    else:
        rows[:0] = [("frames", f"{summary['frames']:,}"), ("episodes", f"{summary['episodes']:,}")]
        lap = f"frame {first['frame']:,}, episode {first['episode']:,}" if first else missing_lap(summary, "none")
        rows.append(("first greedy lap", lap))
    if best:
        rows += [
            ("greedy lap" if _is_offline(summary) else "best greedy lap", _how_far(best)),
            ("its reward", f"{best['lap_reward']:.0f}"),
            ("its steps", f"{best['lap_steps']}"),
            ("forward share", f"{best['forward_share']:.0%}"),
            ("switches per 100 m", f"{best['switches_per_100m']:.1f}"),
        ]
    return rows


def _how_far(attempt: Mapping[str, Any]) -> str:
    if "circuits" in attempt:
        return f"{attempt['laps_completed']} of {attempt['circuits']} circuits"
    return "complete" if attempt["lap_completed"] else f"{attempt['progress']:.0%} of a lap"
