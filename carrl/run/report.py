"""Finds finished and unfinished runs and lines their results up."""

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carrl.errors import CheckpointError
from carrl.run.folder import CONFIG, METRICS, SUMMARY, read_text

HEADER = (
    "run",
    "episodes",
    "frames",
    "first lap: episode",
    "first lap: frame",
    "best lap",
    "lap reward",
    "steps",
    "forward share",
    "switches / 100 m",
)


@dataclass(frozen=True)
class RunResult:
    """One run's folder, read back.

    Attributes:
        label: short name that tells it from the others of the report.
        summary: what `summary.json` holds, or None where the run has not finished.
        episode_returns: of every ended episode, in order.
    """

    label: str
    summary: dict[str, Any] | None
    episode_returns: tuple[float, ...]

    def row(self) -> list[str]:
        """The run's figures under `HEADER`."""
        if self.summary is None:
            return [self.label, str(len(self.episode_returns)), *["unfinished"] * 2, *["-"] * (len(HEADER) - 4)]
        first, best = self.summary["first_lap"], self.summary["evaluation"]
        return [
            self.label,
            f"{self.summary['episodes']:,}",
            f"{self.summary['frames']:,}",
            f"{first['episode']:,}" if first else "never",
            f"{first['frame']:,}" if first else "never",
            "complete" if best["lap_completed"] else f"{best['progress']:.0%}",
            f"{best['lap_reward']:.0f}",
            f"{best['lap_steps']}",
            f"{best['forward_share']:.0%}",
            f"{best['switches_per_100m']:.1f}",
        ]


def find_runs(roots: list[Path]) -> list[RunResult]:
    """Every run below the folders, those in progress or broken off included, in the order of their paths.

    Raises:
        CheckpointError: there is none, or one is damaged.
    """
    found = {config.parent.parent for root in roots for config in root.rglob(str(CONFIG))}
    folders = sorted(found - {folder.parent for folder in found})  # a run of several seeds holds one folder for each
    if not folders:
        names = ", ".join(f"'{root}'" for root in roots)
        raise CheckpointError(f"no run in {names}; name folders that `carrl train` has written")
    return [_read_run(folder, _label(folder, folders)) for folder in folders]


def markdown_table(runs: list[RunResult]) -> str:
    """The runs as a table in Markdown."""
    rows = [HEADER, ["---", *["---:"] * (len(HEADER) - 1)], *(run.row() for run in runs)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _label(folder: Path, folders: list[Path]) -> str:
    """The part of the folder's name in which it differs from the others: seed=3 of seed=3,trainer.frames=100000."""
    words = [set(other.name.split(",")) for other in folders]
    common = set.intersection(*words) if len(folders) > 1 else set()
    return ",".join(word for word in folder.name.split(",") if word not in common) or folder.name


def _read_run(folder: Path, label: str) -> RunResult:
    summary = None
    try:
        if (folder / SUMMARY).exists():
            summary = json.loads(read_text(folder / SUMMARY))
        metrics = read_text(folder / METRICS) if (folder / METRICS).exists() else ""
        returns = tuple(float(row["episode_return"]) for row in csv.DictReader(io.StringIO(metrics)))
    except (ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"run '{folder}': {SUMMARY} or {METRICS} is damaged") from error
    return RunResult(label, summary, returns)
