"""What a run shows on the terminal: its progress, and a table at the end."""

import math
import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from carrl.cli.process import INTERRUPTED, heeded, let_go_of_closed_terminal
from carrl.cli.text.next_steps import print_next
from carrl.cli.text.terminal_table import print_table
from carrl.errors import printable
from carrl.evaluation.results import styles_of
from carrl.report.runs import missing_lap
from carrl.train.callbacks import Callback
from carrl.train.experiment import road_warning
from carrl.train.files import LOG
from carrl.train.replicate_run import RECENT_EPISODES
from carrl.train.trainer import Trainer

_SHOW_CURSOR = "\x1b[?25h"


class StopOnSignals(Callback):
    """Lets the first signal end the run with everything saved, and the second end the process at once.

    A second SIGHUP is passed over: a closing terminal sends it, and so does the shell in it.
    """

    def on_start(self, trainer: Trainer) -> None:
        """Takes the signals over."""
        self._trainer = trainer
        self._previous = {number: signal.signal(number, self._stop) for number in heeded()}

    def on_end(self) -> None:
        """Gives them back."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _stop(self, number: int, _frame: object) -> None:
        if number == signal.SIGHUP:
            let_go_of_closed_terminal()
            if self._trainer.stopping:
                return
        if self._trainer.stopping:
            if sys.stderr.isatty():
                sys.stderr.write(f"{_SHOW_CURSOR}\n")
                sys.stderr.flush()
            os._exit(INTERRUPTED)
        self._trainer.interrupt()


class RoadWarning(Callback):
    """Warns, before training begins, of a track that does not suit the car."""

    def on_start(self, trainer: Trainer) -> None:
        """Prints the warning, if there is one."""
        world = trainer.pipeline.world
        warn(road_warning(world.circuits.all, world))


class ProgressDisplay(Callback):
    """A live progress bar with figures below it."""

    def on_start(self, trainer: Trainer) -> None:
        """Begins to draw."""
        self._trainer = trainer
        self._bar = Progress(SpinnerColumn(), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._task = self._bar.add_task("", total=1.0)
        self._figures = Text()
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, refresh_per_second=4, get_renderable=self._picture)
        self._live.start()

    def _picture(self) -> Group:
        """What is drawn four times a second, also during a compilation, in which no round ends."""
        since = self._trainer.learner.compiling_since
        if since is None:
            return Group(self._bar, self._figures)
        return Group(
            self._bar, self._figures, Text(f"  getting the updates ready for {time.monotonic() - since:.0f} s")
        )

    def on_round(self, trainer: Trainer) -> None:
        """Moves the bar and the figures on."""
        self._bar.update(self._task, completed=min(trainer.share_done, 1.0))
        self._figures.plain = _figures(trainer) if trainer.source.transitions is None else _figures_of_logs(trainer)

    def on_end(self) -> None:
        """Leaves the last state on the screen."""
        self._live.stop()
        if not self._console.is_terminal:  # where rich leaves out the last line's end
            self._console.print()


def follow_run() -> list[Callback]:
    """What follows a run that has the terminal to itself."""
    return [RoadWarning(), StopOnSignals(), ProgressDisplay()]


def warn(sentence: str | None) -> None:
    """Prints a warning on standard error, if there is one."""
    if sentence is not None:
        print(printable(sentence), file=sys.stderr)


def _figures(trainer: Trainer) -> str:
    """Env steps, episodes, laps and returns."""
    runs = trainer.runs
    recent = [run.recent_return for run in runs if not math.isnan(run.recent_return)]
    mean_return = sum(recent) / len(recent) if recent else math.nan
    rate = sum(run.status.frames for run in runs) / max(trainer.wall_time_s, 1e-9)
    own = "".join(f"{name} {value:.2f} · " for name, value in runs[0].status.figures.items())
    return (
        f"  {trainer.frames:,} frames · {sum(run.episodes for run in runs):,} episodes · "
        f"{sum(run.laps for run in runs):,} laps · {rate:,.0f} frames/s\n"
        f"  return of the last {RECENT_EPISODES} episodes {mean_return:.0f} · {own}{_laps_so_far(trainer)}"
    )


def _figures_of_logs(trainer: Trainer) -> str:
    """Updates, and the loss of the replicates' last minibatches."""
    count = len(trainer.runs)
    rate = trainer.updates * count / max(trainer.wall_time_s, 1e-9)
    loss = sum(run.status.loss for run in trainer.runs) / count
    each = "" if count == 1 else f" of each of {count} replicates"
    return (
        f"  {trainer.updates:,} updates{each} · {rate:,.0f} updates/s\n"
        f"  {trainer.source.transitions:,} transitions from logs · loss {loss:.1f}"
    )


def print_results(config: Mapping[str, Any], summaries: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Prints the results of a run, or how to go on with one that was interrupted.

    Raises:
        KeyboardInterrupt: it was.
    """
    if not all(summary["finished"] for summary in summaries):
        print(f"interrupted; everything is saved: go on with carrl train resume={folder}")
        raise KeyboardInterrupt
    if config["trainer"].get("seeds") is None:
        print_summary(summaries[0], folder)
    else:
        print_summaries(summaries, folder)
    trust = summaries[0].get("trust", ())
    flags = "".join(f" --trust {shlex.quote(module)}" for module in trust)
    if trust:
        print(printable(f"it has parts of your own, which are opened again with{flags}"))
    _print_next(config, folder, flags)


def _print_next(config: Mapping[str, Any], folder: Path, trust: str) -> None:
    """Prints what to do with a run that has finished."""
    place, drives_paper = shlex.quote(str(folder)), config["track"].get("name_or_path") == "paper"
    steps = [(f"evaluate {place}{trust} --track {'oval' if drives_paper else 'paper'}", "drive it on another track")]
    if config["trainer"].get("seeds") is not None:
        steps.append((f"report {place}", "compare its seeds"))
    elif (folder / LOG).exists():
        steps.append((f"log replay {shlex.quote(str(folder / LOG))}", "watch an episode of its training in a browser"))
    else:
        steps.append((f"report {place} --best-lap", "see how far it is from the best possible lap"))
    print_next(*steps)


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
    styles = [style for style in styles_of(each["evaluation"] for each in summaries) if style.key != "reversals"]
    rows = [
        [
            *(value_of(summary) for value_of in columns.values()),
            *(style.written(summary["evaluation"]) for style in styles),
        ]
        for summary in summaries
    ]
    header = (*columns, *(style.name for style in styles))
    print_table(f"{len(rows)} seeds on track {summaries[0]['track']}", header, rows)
    Console().print(_place(folder), soft_wrap=True, highlight=False)


def _laps_so_far(trainer: Trainer) -> str:
    """How many replicates lapped the track twice running, or on how many of several tracks their best networks did."""
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
            *((style.name, style.written(best)) for style in styles_of([best]) if style.key != "reversals"),
        ]
    return rows


def _how_far(attempt: Mapping[str, Any]) -> str:
    if "drives" in attempt:
        return f"{attempt['laps_completed']} of {attempt['drives']} drives"
    return "complete" if attempt["lap_completed"] else f"{attempt['progress']:.0%} of a lap"
