"""How the networks drove when they were tried out in training: laps and speed or reward against env steps.

Shapes: `N` runs of a group, `T` points of a curve.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter, StrMethodFormatter

from carrl.render.colours import FAINT
from carrl.render.curves import new_figure, plain_axes, save_figure
from carrl.report.curve_figures import (
    POINTS,
    Curve,
    Look,
    count_frames,
    draw_curves,
    legend_rows,
    looks,
    name_axes,
    name_groups,
)
from carrl.report.groups import Group
from carrl.report.measures import Floats, iqm_band
from carrl.report.runs import RunResult

RUN_LINE: dict[str, Any] = {"linewidth": 0.7, "alpha": 0.45}
"""Of one run, behind its group's curve."""


def draw_trials(path: Path, groups: Sequence[Group]) -> bool:
    """Writes a PNG of every group's evaluations; False, and no file, where no run was tried out twice."""
    runs = {group.label: [run for run in group.counted if len(run.trials.frames) > 1] for group in groups}
    runs = {label: own for label, own in runs.items() if own}
    if not runs:
        return False
    styles = looks(groups)
    laps = [_curve(label, own, [run.trials.laps for run in own]) for label, own in runs.items()]
    others = [_curve(label, own, [run.trials.others for run in own]) for label, own in runs.items()]
    figure = new_figure(height=3.0 + 0.17 * legend_rows(laps))
    left, right = figure.subplots(1, 2)
    for axes, curves in ((left, laps), (right, others)):
        plain_axes(axes)
        draw_curves(axes, curves, styles)
        axes.set_xlim(0, max(curve.points[-1] for curve in curves))
        count_frames(axes, ticks=5)
    for label, own in runs.items():
        for run in own:
            _draw_run(left, run.trials.frames, run.trials.laps, styles[label])
            _draw_run(right, run.trials.frames, run.trials.others, styles[label])
    left.set_ylim(-0.02, 1.04)
    left.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    name_axes(left, "frames (env steps)", "laps completed, of all drives")
    right.yaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    speeds = [run.trials.has_speed for own in runs.values() for run in own]
    name_axes(right, "frames (env steps)", "mean speed of all drives, m/s" if all(speeds) else "reward of a drive")
    right.set_title("thin: each run; thick: interquartile mean, 95 % band", fontsize=7.5, color=FAINT, loc="right")
    name_groups(figure, laps, styles)
    save_figure(figure, path)
    return True


def _curve(label: str, runs: Sequence[RunResult], values: Sequence[Sequence[float]]) -> Curve:
    """The interquartile mean over runs from the last of their first evaluations to the first of their last ones."""
    begin = max(run.trials.frames[0] for run in runs)
    end = max(begin, min(run.trials.frames[-1] for run in runs))
    points: Floats = np.linspace(begin, end, POINTS)
    rows = [np.interp(points, run.trials.frames, own) for run, own in zip(runs, values, strict=True)]
    return Curve(label, len(runs), points, iqm_band(np.stack(rows)))


def _draw_run(axes: Axes, frames: Sequence[int], values: Sequence[float], look: Look) -> None:
    axes.plot(frames, values, color=look.colour, **RUN_LINE)
