"""Every run as a row, and how far each is from the best possible lap."""

import math

from carrl.errors import ConfigError
from carrl.evaluation.best_lap import find_best_lap
from carrl.evaluation.results import Drive
from carrl.report.reading import RunResult
from carrl.report.summary_file import missing_lap
from carrl.report.tables import markdown
from carrl.task.world import World
from carrl.train.build import build_world

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


def runs_table(runs: list[RunResult], best_lap: Drive | None = None) -> str:
    """The runs as a table in Markdown, with their distance from the best possible lap if that is given."""
    header, table = [*HEADER], [_row(run) for run in runs]
    if best_lap is not None:
        header += BEST_LAP_HEADER
        table = [row + _beside(run, best_lap) for row, run in zip(table, runs, strict=True)]
    return markdown(header, table)


def best_lap_of(runs: list[RunResult], bin_size: float) -> Drive:
    """The best possible lap in the world that the runs were trained in.

    Raises:
        ConfigError: it is not one and the same, or no run has a configuration that can be read.
        CarrlError: as `find_best_lap`.
    """
    runs = [run for run in runs if run.config]
    if not runs:
        raise ConfigError("no run has a configuration that can be read; the best possible lap depends on it")
    worlds = [build_world(run.config) for run in runs]
    differing = next((run.label for run, world in zip(runs, worlds, strict=True) if not _alike(world, worlds[0])), None)
    if differing is not None:
        raise ConfigError(f"'{runs[0].label}' and '{differing}' were not trained with the same track, car and sensors")
    world = worlds[0]
    return find_best_lap(world, bin_size)


def _alike(world: World, other: World) -> bool:
    """Whether the same laps are possible without a step near a wall."""
    distances = [each.sensor.max_range * each.reward.near_wall.threshold for each in (world, other)]
    tracks = [[track.as_dict() for track in each.circuits.training] for each in (world, other)]
    same = tracks[0] == tracks[1] and (world.vehicle, world.action) == (other.vehicle, other.action)
    fans = [(each.sensor.rays, each.sensor.field_of_view) for each in (world, other)]
    return same and fans[0] == fans[1] and math.isclose(*distances, rel_tol=1e-4)


def _row(run: RunResult) -> list[str]:
    """The run's figures under `HEADER`."""
    if run.summary is None:
        return [run.label, str(len(run.episode_returns)), *[run.state] * 2, *["-"] * (len(HEADER) - 4)]
    first = run.summary["first_lap"]
    row = [
        run.label,
        f"{run.summary['episodes']:,}",
        f"{run.summary['frames']:,}",
        *([f"{first['episode']:,}", f"{first['frame']:,}"] if first else [missing_lap(run.summary, "never")] * 2),
    ]
    best = run.summary["evaluation"]
    if best is None:
        return [*row, *["-"] * (len(HEADER) - len(row))]
    return [
        *row,
        "complete" if best["lap_completed"] else f"{best['progress']:.0%}",
        f"{best['lap_reward']:.0f}",
        f"{best['lap_steps']}",
        f"{best['forward_share']:.0%}",
        f"{best['switches_per_100m']:.1f}",
        f"{best['reversals']}",
    ]


def _beside(run: RunResult, best_lap: Drive) -> list[str]:
    """The run's figures under `BEST_LAP_HEADER`."""
    own = (run.summary or {}).get("evaluation")
    if own is None:
        return ["-"] * len(BEST_LAP_HEADER)
    return [
        f"{own[name] / getattr(best_lap, name):.2f}" if getattr(best_lap, name) else "-"
        for name in ("forward_share", "switches_per_100m")
    ]
