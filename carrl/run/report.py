"""Finds finished and unfinished runs and lines their results up."""

import csv
import io
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carrl.errors import CheckpointError, ConfigError
from carrl.run.best_lap import find_best_lap
from carrl.run.build import World, build_world
from carrl.run.evaluation import Drive
from carrl.run.folder import CONFIG, METRICS, SUMMARY, load_config, read_text
from carrl.sim.simulator import Simulator

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
    "reversals",
)
BEST_LAP_HEADER = ("forward / best", "switches / best")
"""What is added where the best possible lap is known: a run's figures as shares of its."""


@dataclass(frozen=True)
class RunResult:
    """One run's folder, read back.

    Attributes:
        label: short name that tells it from the others of the report.
        folder: the run's.
        summary: what `summary.json` holds, or None where the run has not finished.
        episode_returns: of every ended episode, in order.
    """

    label: str
    folder: Path
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
            f"{best['reversals']}",
        ]

    def beside(self, best_lap: Drive) -> list[str]:
        """The run's figures under `BEST_LAP_HEADER`."""
        if self.summary is None:
            return ["-"] * len(BEST_LAP_HEADER)
        own = self.summary["evaluation"]
        return [
            f"{own[name] / getattr(best_lap, name):.2f}" if getattr(best_lap, name) else "-"
            for name in ("forward_share", "switches_per_100m")
        ]


def find_runs(roots: list[Path]) -> list[RunResult]:
    """Every run below the folders, those in progress or broken off included, in the natural order of their paths.

    Raises:
        CheckpointError: there is none, or one is damaged.
    """
    found = {config.parent.parent for root in roots for config in root.rglob(str(CONFIG))}
    found -= {folder.parent for folder in found}  # a run of several seeds holds one folder for each
    folders = sorted(found, key=_in_natural_order)
    if not folders:
        names = ", ".join(f"'{root}'" for root in roots)
        raise CheckpointError(f"no run in {names}; name folders that `carrl train` has written")
    return [_read_run(folder, label) for folder, label in zip(folders, _labels(folders), strict=True)]


def best_lap_of(runs: list[RunResult], bin_size: float) -> Drive:
    """The best possible lap in the world that the runs were trained in.

    Raises:
        ConfigError: it is not one and the same.
        CarrlError: as `find_best_lap`.
    """
    worlds = [build_world(load_config(run.folder)) for run in runs]
    differing = next((run.label for run, world in zip(runs, worlds, strict=True) if not _alike(world, worlds[0])), None)
    if differing is not None:
        raise ConfigError(f"'{runs[0].label}' and '{differing}' were not trained with the same track, car and sensors")
    world = worlds[0]
    return find_best_lap(Simulator(world.track, world.vehicle, world.sensor), world.reward, bin_size)


def _alike(world: World, other: World) -> bool:
    """Whether the same laps are possible without a step near a wall."""
    distances = [each.sensor.max_range * each.reward.proximity_threshold for each in (world, other)]
    tracks = [[track.as_dict() for track in each.circuits.training] for each in (world, other)]
    same = tracks[0] == tracks[1] and world.vehicle == other.vehicle
    fans = [(each.sensor.rays, each.sensor.field_of_view) for each in (world, other)]
    return same and fans[0] == fans[1] and math.isclose(*distances, rel_tol=1e-4)


def markdown_table(runs: list[RunResult], best_lap: Drive | None = None) -> str:
    """The runs as a table in Markdown, with their distance from the best possible lap if that is given."""
    header, table = [*HEADER], [run.row() for run in runs]
    if best_lap is not None:
        header += BEST_LAP_HEADER
        table = [row + run.beside(best_lap) for row, run in zip(table, runs, strict=True)]
    rows = [header, ["---", *["---:"] * (len(header) - 1)], *table]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _in_natural_order(folder: Path) -> list[tuple[str, int]]:
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


def _read_run(folder: Path, label: str) -> RunResult:
    summary = None
    try:
        if (folder / SUMMARY).exists():
            summary = json.loads(read_text(folder / SUMMARY))
        metrics = read_text(folder / METRICS) if (folder / METRICS).exists() else ""
        learnt_from_logs = isinstance(summary, dict) and "transitions" in summary
        rows = [] if learnt_from_logs else csv.DictReader(io.StringIO(metrics))
        returns = tuple(float(row["episode_return"]) for row in rows)
    except (ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"run '{folder}': {SUMMARY} or {METRICS} is damaged") from error
    return RunResult(label, folder, summary, returns)
