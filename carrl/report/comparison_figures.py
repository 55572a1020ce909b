"""Groups compared: a row for each with a dot for each run, and the probabilities of improvement of pairs."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from carrl.render.colours import FAINT, INK, VERMILLION
from carrl.render.curves import new_figure, plain_axes, save_figure
from carrl.report.curve_figures import Look, looks, wrapped
from carrl.report.findings import Comparison, Findings, GroupFigure
from carrl.report.groups import Group
from carrl.report.measures import (
    FIRST_LAP_FRAMES,
    FIRST_LAP_SECONDS,
    FORWARD_SHARE,
    MEAN_SPEED,
    MEASURES,
    STEERING_CHANGE,
    SWITCHES,
    Estimate,
    Measure,
)

LABEL_CHARACTERS = 24
WIDE = 20
"""From such a ratio of greatest and least value on, an axis is logarithmic."""
AXIS = {
    FIRST_LAP_FRAMES.key: "first greedy lap, frames (env steps)",
    FIRST_LAP_SECONDS.key: "first greedy lap, s since training began",
    SWITCHES.key: "switches of action per 100 m (fewer is smoother)",
    FORWARD_SHARE.key: "share of steps forward (more is smoother)",
    MEAN_SPEED.key: "mean speed of the best lap, m/s",
    STEERING_CHANGE.key: "change of the steering per step (less is smoother)",
}
MOST_COLUMNS = 3
TITLE_CHARACTERS = 84
"""As many fit beside each other into the figure's width."""
UNDECIDED = "#7a7a7a"


def draw_first_laps(path: Path, findings: Findings) -> bool:
    """Writes a PNG of frames and seconds until the first lap; False, and no file, where no run drove to learn."""
    return _draw_strips(path, findings, (FIRST_LAP_FRAMES, FIRST_LAP_SECONDS))


def draw_smoothness(path: Path, findings: Findings) -> bool:
    """Writes a PNG of how the best laps are driven; False, and no file, where no run lapped."""
    by_name = any(key in figures for figures in findings.figures for key in (SWITCHES.key, FORWARD_SHARE.key))
    return _draw_strips(path, findings, (SWITCHES, FORWARD_SHARE) if by_name else (MEAN_SPEED, STEERING_CHANGE))


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
        arrows: dict[str, Any] = {"s": 26, "marker": ">", "facecolors": "white", "edgecolors": look.colour}
        axes.scatter(stopped, np.full(len(stopped), row - 0.12), **arrows)
        place: dict[str, Any] = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 7}
        axes.annotate(f"never: {len(stopped)}", (max(stopped), row - 0.12), **place)
    estimate = figure.estimate
    line: dict[str, Any] = {"color": look.colour, "linewidth": 2.2, "solid_capstyle": "butt"}
    if figure.runs > 1:
        axes.plot([estimate.low, estimate.high], [row + 0.14] * 2, **line)
    mark: dict[str, Any] = {"markersize": 6.5, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 4}
    axes.plot(estimate.value, row + 0.14, look.mark, color=look.colour, **mark)


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


def draw_improvement(path: Path, findings: Findings) -> bool:
    """Writes a PNG of every pair that was compared; False, and no file, where none was."""
    if not findings.comparisons:
        return False
    order = {group.label: index for index, group in enumerate(findings.groups)}
    pairs = list(dict.fromkeys(_pair(comparison, order) for comparison in findings.comparisons))
    measures = [each for each in MEASURES if any(comparison.measure is each for comparison in findings.comparisons)]
    columns = min(MOST_COLUMNS, len(pairs))
    rows = math.ceil(len(pairs) / columns)
    titles = [_title(pair, TITLE_CHARACTERS // columns) for pair in pairs]
    title_height = 0.14 * max(title.count("\n") for title in titles)
    figure = new_figure(height=0.7 + rows * (0.45 + title_height + 0.21 * len(measures)))
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat)
    for axes, pair, title in zip(panels, pairs, titles, strict=False):
        shown = [comparison for comparison in findings.comparisons if _pair(comparison, order) == pair]
        _draw_panel(axes, shown, pair, measures)
        axes.set_title(title, fontsize=8, color=INK, loc="left", parse_math=False)
    for axes in panels[len(pairs) :]:
        axes.set_visible(False)
    figure.supxlabel("probability that the group above is better than the other", color=INK, fontsize=8.5)
    figure.legend(handles=_significance_legend(), loc="outside upper left", ncols=2, frameon=False, fontsize=8)
    save_figure(figure, path)
    return True


def _pair(comparison: Comparison, order: dict[str, int]) -> tuple[str, str]:
    """The later group and the earlier one."""
    later, earlier = sorted((comparison.first, comparison.second), key=order.__getitem__, reverse=True)
    return later, earlier


def _title(pair: tuple[str, str], characters: int) -> str:
    return f"{wrapped(pair[0], characters)}\nagainst {wrapped(pair[1], characters - 8)}"


def _draw_panel(axes: Axes, shown: Sequence[Comparison], pair: tuple[str, str], measures: Sequence[Measure]) -> None:
    plain_axes(axes)
    axes.axvline(0.5, color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)))
    for comparison in shown:
        row, chance = measures.index(comparison.measure), _of(pair[0], comparison)
        colour = VERMILLION if comparison.significant else UNDECIDED
        axes.plot([chance.low, chance.high], [row, row], color=colour, linewidth=2.2, solid_capstyle="butt")
        face = colour if comparison.significant else "white"
        axes.plot(chance.value, row, "o", color=colour, markerfacecolor=face, markersize=5.5, clip_on=False, zorder=3)
    axes.set_yticks(range(len(measures)), [measure.name for measure in measures])
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.set_ylim(len(measures) - 0.4, -0.6)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "1"])
    axes.tick_params(labelbottom=True)


def _of(group: str, comparison: Comparison) -> Estimate:
    """The probability that this group is the better one."""
    return comparison.probability if comparison.first == group else comparison.probability.complement


def _significance_legend() -> list[Line2D]:
    style: dict[str, Any] = {"marker": "o", "linewidth": 2.2, "markersize": 5.5}
    return [
        Line2D([], [], color=VERMILLION, label="significant, with 95 % interval", **style),
        Line2D([], [], color=UNDECIDED, markerfacecolor="white", label="not significant", **style),
    ]
