"""What a sweep shows on the terminal: a line for each job that begins or ends, and a table at the end."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.markup import escape

from carrl.cli.text.terminal_table import print_table
from carrl.printable import printable
from carrl.report.runs import missing_lap
from carrl.train.sweep import JobNote, SweepFolder, read_summaries

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
            print_table(f"{len(rows)} of {max(self._jobs, len(rows))} jobs", _HEADER, rows)
        console = Console(soft_wrap=True, highlight=False)
        for note in notes.values():
            if note.error is not None:
                console.print(escape(printable(f"failed: {note.name}: {note.error}")))
        console.print(escape(printable(f"results in {sweep.path}; compare them: carrl report {sweep.path}")))

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


def _result(summaries: Sequence[Mapping[str, Any]]) -> str:
    """How far the agents of a job have come, in a few words."""
    if not summaries:
        return "no result"
    laps, first, progress, *_ = _figures(summaries)
    if any(summary["first_lap"] for summary in summaries):
        return f"first greedy lap at {first} frames" + (f" (median), {laps} lap" if len(summaries) > 1 else "")
    return f"{progress} of a lap" if progress else "not driven yet"


def _figures(summaries: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Laps, and medians over the agents of a job."""
    first_laps = [summary["first_lap"]["frame"] for summary in summaries if summary["first_lap"]]
    drives = [summary["evaluation"] for summary in summaries if summary["evaluation"]]
    lapped = sum(drive["lap_completed"] for drive in drives)
    if not drives:
        return ("", "none", "", "", "")
    values = [median(drive[key] for drive in drives) for key in ("progress", "lap_reward", "forward_share")]
    return (
        f"{lapped} of {len(summaries)}",
        f"{median(first_laps):,.0f}" if first_laps else max(missing_lap(each, "none") for each in summaries),
        f"{values[0]:.0%}",
        f"{values[1]:.0f}",
        f"{values[2]:.0%}",
    )


def _time(note: JobNote) -> str:
    return "" if note.state in ("running", "finished before") else _duration(note.seconds)


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
