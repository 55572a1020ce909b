"""A row for each group and a dot for each of its runs, with the interquartile mean and its interval."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from carrl.render.colours import FAINT, INK
from carrl.render.figure import new_figure, plain_axes, save_figure
from carrl.report.figures.series import Look, looks, wrapped
from carrl.report.findings import Findings, GroupFigure
from carrl.report.groups import Group
from carrl.report.measures import FIRST_LAP_FRAMES, FIRST_LAP_SECONDS, FORWARD_SHARE, SWITCHES, Measure

LABEL_CHARACTERS = 24
WIDE = 20
"""From such a ratio of greatest and least value on, an axis is logarithmic."""
AXIS = {
    FIRST_LAP_FRAMES.key: "first greedy lap, frames (env steps)",
    FIRST_LAP_SECONDS.key: "first greedy lap, s since training began",
    SWITCHES.key: "switches of action per 100 m (fewer is smoother)",
    FORWARD_SHARE.key: "share of steps forward (more is smoother)",
}


def draw_first_laps(path: Path, findings: Findings) -> bool:
    """Writes a PNG of frames and seconds until the first lap; False, and no file, where no run drove to learn."""
    return _draw_strips(path, findings, (FIRST_LAP_FRAMES, FIRST_LAP_SECONDS))


def draw_smoothness(path: Path, findings: Findings) -> bool:
    """Writes a PNG of how the best laps switch and drive forward; False, and no file, where no run lapped."""
    return _draw_strips(path, findings, (SWITCHES, FORWARD_SHARE))


def _draw_strips(path: Path, findings: Findings, measures: tuple[Measure, Measure]) -> bool:
    if not any(measure.key in figures for figures in findings.figures for measure in measures):
        return False
    groups, styles = findings.groups, looks(findings.groups)
    figure = new_figure(height=1.1 + 0.5 * len(groups))
    for axes, measure in zip(figure.subplots(1, 2, sharey=True), measures, strict=True):
        _draw_axes(axes, measure, groups)
        for row, (group, figures) in enumerate(zip(groups, findings.figures, strict=True)):
            if measure.key in figures:
                _draw_row(axes, row, group, measure, figures[measure.key], styles[group.label])
            else:
                place = axes.get_yaxis_transform()
                axes.text(0.03, row, "none", transform=place, va="center", color=FAINT, fontsize=8)
        _scale(axes, groups, measure)
    figure.legend(handles=_legend(), loc="outside upper left", ncols=3, frameon=False, fontsize=8)
    save_figure(figure, path)
    return True


def _legend() -> list[Line2D]:
    mean = Line2D([], [], color=FAINT, marker="o", markersize=6.5, linewidth=2.2, markeredgecolor="white")
    mean.set_label("interquartile mean, 95 % interval")
    return [Line2D([], [], color=FAINT, marker="o", markersize=3.5, linestyle="none", label="one run"), mean]


def _draw_axes(axes: Axes, measure: Measure, groups: Sequence[Group]) -> None:
    plain_axes(axes)
    axes.grid(visible=False)
    axes.grid(axis="x", color="#e4e4e4", linewidth=0.6)
    axes.set_yticks(range(len(groups)), [wrapped(group.label, LABEL_CHARACTERS) for group in groups], parse_math=False)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(groups) - 0.45, -0.55)
    axes.set_xlabel(AXIS[measure.key], color=INK, fontsize=8.5)


def _draw_row(axes: Axes, row: int, group: Group, measure: Measure, figure: GroupFigure, look: Look) -> None:
    """Dots above the line of the interval; a run that never got there is an arrow where it was stopped."""
    values = [(measure.value(run), measure.limit(run)) for run in group.counted]
    reached = np.sort([value for value, _ in values if value is not None and value != math.inf])
    stopped = [limit for value, limit in values if value == math.inf and limit is not None]
    axes.scatter(reached, row - 0.12 - _stacked(reached), s=13, c=look.colour, alpha=0.65, linewidths=0, zorder=3)
    if stopped:
        axes.scatter(
            stopped, np.full(len(stopped), row - 0.12), s=26, marker=">", facecolors="white", edgecolors=look.colour
        )
        axes.annotate(
            f"never: {len(stopped)}",
            (max(stopped), row - 0.12),
            (6, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
        )
    estimate = figure.estimate
    if figure.runs > 1:
        axes.plot(
            [estimate.low, estimate.high], [row + 0.14] * 2, color=look.colour, linewidth=2.2, solid_capstyle="butt"
        )
    axes.plot(
        estimate.value,
        row + 0.14,
        look.mark,
        color=look.colour,
        markersize=6.5,
        markeredgecolor="white",
        markeredgewidth=0.6,
        zorder=4,
    )


def _stacked(values: np.ndarray) -> np.ndarray:
    """How far each of the ascending values is moved upwards, [N], so that equal ones stand on each other."""
    first_of_equals = np.searchsorted(values, values, side="left")
    return np.minimum(0.07 * (np.arange(len(values)) - first_of_equals), 0.32)


def _scale(axes: Axes, groups: Sequence[Group], measure: Measure) -> None:
    found = [each(run) for group in groups for run in group.counted for each in (measure.value, measure.limit)]
    finite = [value for value in found if value is not None and 0 < value < math.inf]
    shown = axes.dataLim.intervalx
    if measure.limit(groups[0].runs[0]) is not None and finite and shown[0] > 0 and shown[1] / shown[0] > WIDE:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 2.5, 5, 10]))
    axes.margins(x=0.08)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _written(measure, value)))


def _written(measure: Measure, value: float) -> str:
    return f"{100 * value:g} %" if measure is FORWARD_SHARE else f"{value:,g}"
