"""What many runs show on the terminal: a line for each that begins or ends, and a table at the end.

SweepConsole tells of a sweep's jobs, TuningConsole of a study's trials. Nothing here waits for torch.
"""

import math
import shlex
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from rich.console import Console
from rich.markup import escape

from carrl.cli.text.next_steps import print_next
from carrl.cli.text.terminal_table import print_table
from carrl.errors import printable
from carrl.report.runs import missing_lap
from carrl.train.sweep import JobNote, SweepFolder, read_summaries

MOST_ROWS = 20
"""Trials in a table."""
_HEADER = ("job", "result", "laps", "first greedy lap", "progress", "reward", "forward", "time")


class SweepConsole:
    """Tells how a sweep goes, from the notes of its jobs.

    Args:
        jobs: how many there will be; 0 if that is not known.
    """

    def __init__(self, jobs: int) -> None:
        """Shows nothing yet."""
        self._jobs = jobs
        self._began = time.monotonic()
        self._shown: dict[Path, str] = {}
        self._console = Console(stderr=True, soft_wrap=True, highlight=False)

    def show(self, sweep: SweepFolder) -> None:
        """Prints a line for each job that has begun or ended since the last call."""
        notes = sweep.notes()
        self._jobs = max(self._jobs, len(notes))
        for folder, note in notes.items():
            if self._shown.get(folder) != note.state:
                self._shown[folder] = note.state
                line = f"[{note.number + 1}/{self._jobs}] {note.name} {self._told(folder, note, notes.values())}"
                self._console.print(escape(printable(line)))

    def print_results(self, sweep: SweepFolder) -> None:
        """Prints a table with a row for each job, and which failed and why."""
        notes = sweep.notes()
        rows = [
            (note.name, note.state, *_figures(read_summaries(folder)), _time(note)) for folder, note in notes.items()
        ]
        if rows:
            header = [*_HEADER[:-2], _style_of([row[-2] for row in rows]), _HEADER[-1]]
            print_table(f"{len(rows)} of {max(self._jobs, len(rows))} jobs", header, rows)
        console = Console(soft_wrap=True, highlight=False)
        for note in notes.values():
            if note.error is not None:
                console.print(escape(printable(f"failed: {note.name}: {note.error}")))
        console.print(escape(printable(f"results in {sweep.path}")))
        place = shlex.quote(str(sweep.path))
        if any(note.state.startswith("finished") for note in notes.values()):
            print_next(
                (f"report {place} --out report", "compare them, with figures"),
                (f"evaluate {place} --track serpentine", "drive them all on another track"),
            )

    def _told(self, folder: Path, note: JobNote, notes: Any) -> str:
        if note.state == "running":
            return "begins"
        if note.error is not None:
            return f"failed: {note.error}"
        ended = sum(each.state != "running" for each in notes)
        new = [each for each in notes if each.state in ("finished", "failed")]
        remaining = self._jobs - ended
        seconds = (time.monotonic() - self._began) / len(new) * remaining if new else 0.0
        wait = f"; about {_duration(seconds)} left" if seconds and note.state == "finished" else ""
        took = "" if note.state == "finished before" else f" after {_duration(note.seconds)}"
        return f"{note.state}{took}: {_result(read_summaries(folder))}{wait}"


def _style_of(cells: Sequence[str]) -> str:
    """What a column tells of how cars drive: their speed, the share of steps forward, or both."""
    names = {"mean speed" if cell.endswith("m/s") else "forward" for cell in cells if cell}
    return " or ".join(sorted(names)) or _HEADER[-2]


def _result(summaries: Sequence[Mapping[str, Any]]) -> str:
    """How far the replicates of a job have come, in a few words."""
    if not summaries:
        return "no result"
    laps, first, progress, *_ = _figures(summaries)
    if any(summary["first_lap"] for summary in summaries):
        return f"first greedy lap at {first} frames" + (f" (median), {laps} lap" if len(summaries) > 1 else "")
    return f"{progress} of a lap" if progress else "not driven yet"


def _figures(summaries: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Laps, and medians over the replicates of a job."""
    first_laps = [summary["first_lap"]["frame"] for summary in summaries if summary["first_lap"]]
    drives = [summary["evaluation"] for summary in summaries if summary["evaluation"]]
    lapped = sum(drive["lap_completed"] for drive in drives)
    if not drives:
        return ("", "none", "", "", "")
    values = [median(drive[key] for drive in drives) for key in ("progress", "lap_reward")]
    key = "mean_speed" if "mean_speed" in drives[0] else "forward_share"
    style = median(drive.get(key, math.nan) for drive in drives)
    return (
        f"{lapped} of {len(summaries)}",
        f"{median(first_laps):,.0f}" if first_laps else max(missing_lap(each, "none") for each in summaries),
        f"{values[0]:.0%}",
        f"{values[1]:.0f}",
        f"{style:.1f} m/s" if key == "mean_speed" else "" if math.isnan(style) else f"{style:.0%}",
    )


def _time(note: JobNote) -> str:
    return "" if note.state in ("running", "finished before") else _duration(note.seconds)


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


class TrialRow(NamedTuple):
    """A trial that has ended.

    Attributes:
        number: from 0.
        end: "complete", "given up" or "failed".
        value: of one that is complete.
        settings: what it drew.
        seconds: that it took.
        error: what ended it, if it failed.
    """

    number: int
    end: str
    value: float | None
    settings: Mapping[str, str]
    seconds: float
    error: str | None


class TuningConsole:
    """Tells how tuning goes.

    Args:
        trials: how many there will be.
        keys: what they draw.
        maximizes: whether greater values are better.
    """

    def __init__(self, trials: int, keys: Sequence[str], maximizes: bool) -> None:
        self._trials, self._keys, self._maximizes = trials, keys, maximizes
        self._console = Console(stderr=True, soft_wrap=True, highlight=False)

    def show_rest(self, rows: Sequence[TrialRow]) -> None:
        """Prints what is still to come, once the first trials tell."""
        if rows:
            seconds = sum(row.seconds for row in rows) / len(rows) * (self._trials - len(rows))
            self._console.print(f"      about {seconds / 60:.1f} min left")

    def show(self, rows: Sequence[TrialRow]) -> None:
        """Prints the latest trial."""
        row = rows[-1]
        settings = " ".join(f"{key}={_short(value)}" for key, value in row.settings.items())
        told = row.error or ("given up, as it does worse than half of the others" if row.value is None else _value(row))
        self._console.print(
            escape(printable(f"[{len(rows)}/{self._trials}] {settings}: {told} after {row.seconds:.1f} s"))
        )

    def print_results(self, rows: Sequence[TrialRow]) -> None:
        """Prints the trials, the best first, and how many were given up."""
        if not rows:
            return
        ordered = sorted(rows, key=self._rank)
        cells = [
            (str(row.number), row.end, _value(row), *(_short(row.settings.get(key, "")) for key in self._keys))
            for row in ordered[:MOST_ROWS]
        ]
        given_up = sum(row.end == "given up" for row in rows)
        print_table(f"{len(rows)} trials, {given_up} given up early", ("trial", "end", "value", *self._keys), cells)

    def _rank(self, row: TrialRow) -> float:
        if row.value is None:
            return math.inf
        return -row.value if self._maximizes else row.value


def _value(row: TrialRow) -> str:
    return "" if row.value is None else f"{row.value:,.5g}" if abs(row.value) < 100 else f"{row.value:,.0f}"


def _short(value: str) -> str:
    """A number with four digits; other values as they are."""
    try:
        return f"{float(value):.4g}" if "." in value or "e" in value else value
    except ValueError:
        return value
