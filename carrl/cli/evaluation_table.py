"""The table of `carrl evaluate`: figures with their intervals, the rule's below those of the policy."""

from collections.abc import Mapping, Sequence
from typing import Any

from carrl.cli.text.terminal_table import print_table

HEADER = (
    "laps",
    "95 %",
    "progress",
    "collisions / km",
    "95 %",
    "lap reward",
    "steps",
    "forward share",
    "switches / 100 m",
    "near-wall share",
)

Figures = Mapping[str, Any]


def print_evaluation(document: Figures) -> None:
    """Prints a table of the tracks and, of several runs, one of these."""
    tracks, name = document["tracks"], f"{document['policy']} policy"
    rows = [row for track in tracks for row in _rows(track["track"], track)]
    if len(tracks) > 1:
        rows += _rows(f"all {len(tracks)} tracks", document["all"])
    print_table(f"{name} of {document['run']}", ("track", *HEADER), rows)
    runs = document.get("runs", ())
    if runs:
        print_table(f"{name} of each run, all tracks", ("seed", *HEADER), _rows_of_runs(runs, document["all"]))


def _rows_of_runs(runs: Sequence[Figures], together: Figures) -> list[list[str]]:
    return [*([str(run["seed"]), *_cells(run["all"])] for run in runs), *_rows("all", together)]


def _rows(name: str, figures: Figures) -> list[list[str]]:
    """A row of the policy's figures and, where they are known, one of the rule's."""
    rows = [[name, *_cells(figures)]]
    return [*rows, ["  rule", *_cells(figures["rule"])]] if "rule" in figures else rows


def _cells(figures: Figures) -> list[str]:
    low, high = figures["intervals"]["completion"]
    least, most = figures["intervals"]["collisions_per_km"]
    return [
        f"{figures['laps_completed']}/{figures['starts']}",
        f"{100 * low:.0f}-{100 * high:.0f}%",
        _mean(figures, "progress", 100, 1, "%"),
        f"{figures['collisions_per_km']:.3f}",
        f"{least:.3f}-{most:.3f}",
        f"{figures['lap_reward']:.0f}",
        f"{figures['lap_steps']:.0f}",
        _mean(figures, "forward_share", 100, 0, "%"),
        _mean(figures, "switches_per_100m", 1, 1),
        f"{figures['near_wall_share']:.1%}",
    ]


def _mean(figures: Figures, name: str, scale: float, digits: int, unit: str = "") -> str:
    """A mean with half the width of its interval, if it has one."""
    interval = figures["intervals"][name]
    text = f"{scale * figures[name]:.{digits}f}"
    return f"{text}{unit}" if interval is None else f"{text}±{scale * (interval[1] - interval[0]) / 2:.{digits}f}{unit}"
