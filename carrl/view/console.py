"""What a run shows on the terminal: its progress, and a table at the end."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from carrl.run.agent_run import RECENT_EPISODES
from carrl.run.trainer import Trainer

FILE_WIDTH = 160
"""Columns of a table that does not go to a terminal, whose width is unknown."""


class TrainingDisplay:
    """A live progress bar with figures below it; use it in a `with` statement and call it after every round."""

    def __init__(self, frames_limit: int, episodes_limit: int) -> None:
        """Shows nothing before the first round."""
        self._frames_limit, self._episodes_limit = frames_limit, episodes_limit
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

    def __call__(self, trainer: Trainer) -> None:
        """Moves the bar and the figures on."""
        episodes = min(run.episodes for run in trainer.runs)  # the run that ends last
        done = max(trainer.frames / self._frames_limit, episodes / self._episodes_limit)
        self._bar.update(self._task, completed=min(done, 1.0))
        self._figures.plain = _describe(trainer)


def _describe(trainer: Trainer) -> str:
    runs = trainer.runs
    recent = [run.recent_return for run in runs if not math.isnan(run.recent_return)]
    lapped = sum(run.first_lap is not None for run in runs)
    rate = sum(run.moment.frames for run in runs) / max(trainer.wall_time_s, 1e-9)
    return (
        f"  {trainer.frames:,} frames · {sum(run.episodes for run in runs):,} episodes · "
        f"{sum(run.laps for run in runs):,} laps · {rate:,.0f} frames/s\n"
        f"  return of the last {RECENT_EPISODES} episodes {sum(recent) / len(recent) if recent else math.nan:.0f} · "
        f"epsilon {runs[0].moment.epsilon:.2f} · greedy lap by {lapped} of {len(runs)}"
    )


def print_summary(summary: Mapping[str, Any], folder: Path) -> None:
    """Prints the run's result as a short table."""
    table = Table(title=f"seed {summary['seed']} on track {summary['track']}", title_justify="left")
    table.add_column("result")
    table.add_column("", justify="right")
    for name, value in _summary_rows(summary):
        table.add_row(name, value)
    console = Console()
    console.print(table)
    console.print(f"results in {folder}", soft_wrap=True, highlight=False)


def print_summaries(summaries: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Prints a line for each of several seeds; `carrl report` has more."""
    header = (
        "seed",
        "frames",
        "episodes",
        "first greedy lap",
        "progress",
        "reward",
        "forward",
        "switches / 100 m",
    )
    rows = []
    for summary in summaries:
        first, best = summary["first_lap"], summary["evaluation"]
        rows.append(
            [
                str(summary["seed"]),
                f"{summary['frames']:,}",
                f"{summary['episodes']:,}",
                f"{first['frame']:,}" if first else "none",
                f"{best['progress']:.0%}",
                f"{best['lap_reward']:.0f}",
                f"{best['forward_share']:.0%}",
                f"{best['switches_per_100m']:.1f}",
            ]
        )
    print_table(f"{len(rows)} seeds on track {summaries[0]['track']}", header, rows)
    Console().print(f"results in {folder}", soft_wrap=True, highlight=False)


def _summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    first, best = summary["first_lap"], summary["evaluation"]
    rows = [
        ("frames", f"{summary['frames']:,}"),
        ("episodes", f"{summary['episodes']:,}"),
        ("updates", f"{summary['updates']:,}"),
        ("wall time", f"{summary['wall_time_s']:.1f} s"),
        (
            "first update",
            "none" if summary["first_update_s"] is None else f"after {summary['first_update_s']:.1f} s",
        ),
        ("first greedy lap", f"frame {first['frame']:,}, episode {first['episode']:,}" if first else "none"),
    ]
    if best:
        rows += [
            ("best greedy lap", "complete" if best["lap_completed"] else f"{best['progress']:.0%} of a lap"),
            ("its reward", f"{best['lap_reward']:.0f}"),
            ("its steps", f"{best['lap_steps']}"),
            ("forward share", f"{best['forward_share']:.0%}"),
            ("switches per 100 m", f"{best['switches_per_100m']:.1f}"),
        ]
    return rows


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints a table whose first column is text and whose others are figures."""
    table = Table(title=title, title_justify="left")
    for index, name in enumerate(header):
        table.add_column(name, justify="left" if index == 0 else "right", no_wrap=index == 0)
    for row in rows:
        table.add_row(*row)
    console = Console()
    if not console.is_terminal:
        console.width = FILE_WIDTH
    console.print(table)
