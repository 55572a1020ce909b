"""Curves of groups with their bands: return against frames, and the share of runs that reach a score or lap by a time.

A group has the same colour, line and mark in every figure. Shapes: `N` runs of a group, `T` points of a curve.
"""

import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter, StrMethodFormatter

from carrl.render.colours import BLACK, BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, SKY, VERMILLION
from carrl.render.curves import new_figure, plain_axes, save_figure
from carrl.report.findings import values_of
from carrl.report.groups import Group
from carrl.report.measures import (
    FINAL_RETURN,
    FIRST_LAP_FRAMES,
    LAP_REWARD,
    Band,
    Floats,
    Measure,
    iqm_band,
    share_band,
)

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
LINES: tuple[tuple[float, tuple[float, ...]], ...] = ((0, ()), (0, (5, 2)), (0, (1.5, 1.5)), (0, (5, 2, 1.5, 2)))
MARKS = ("o", "s", "^", "D", "v", "P", "X")
MANY = 4
"""More bands than that are fainter, for they lie on one another."""
LABEL_CHARACTERS = 108
"""As many fit beside each other into a legend as wide as the figure."""
POINTS = 201
"""On the horizontal axis, the same for all groups."""


@dataclass(frozen=True)
class Curve:
    """A curve of a group with its 95 % band.

    Attributes:
        label: the group's.
        runs: how many it is of.
        points: on the horizontal axis, [T].
        band: interquartile mean or share there.
    """

    label: str
    runs: int
    points: Floats
    band: Band


@dataclass(frozen=True)
class Look:
    """Of a group."""

    colour: str
    line: tuple[float, tuple[float, ...]]
    mark: str


def looks(groups: Sequence[Group]) -> dict[str, Look]:
    """By the groups' labels; lines differ where colours are used up, and with colours for those who see none."""
    return {
        group.label: Look(
            COLOURS[index % len(COLOURS)],
            LINES[(index // len(COLOURS) + index % len(COLOURS)) % len(LINES)],
            MARKS[index % len(MARKS)],
        )
        for index, group in enumerate(groups)
    }


def draw_curves(axes: Axes, curves: Sequence[Curve], styles: dict[str, Look], steps: bool = False) -> None:
    """Each curve as a line in its band; `steps` for shares, which jump."""
    alpha = 0.16 if len(curves) <= MANY else 0.08
    for curve in curves:
        look, band = styles[curve.label], curve.band
        if curve.runs > 1:
            fill: dict[str, Any] = {"color": look.colour, "alpha": alpha, "linewidth": 0}
            axes.fill_between(curve.points, band.low, band.high, step="post" if steps else None, **fill)
        line: dict[str, Any] = {"color": look.colour, "linestyle": look.line, "linewidth": 1.6}
        axes.plot(curve.points, band.value, drawstyle="steps-post" if steps else "default", **line)


def name_groups(figure: Figure, curves: Sequence[Curve], styles: dict[str, Look]) -> None:
    """A legend above the panels."""
    handles = []
    for curve in curves:
        look = styles[curve.label]
        line: dict[str, Any] = {"color": look.colour, "linestyle": look.line, "linewidth": 1.6}
        handles.append(Line2D([], [], label=_named(curve), **line))
    legend = figure.legend(
        handles=handles, loc="outside upper left", ncols=_columns(curves), frameon=False, fontsize=8, handlelength=2.6
    )
    for text in legend.get_texts():
        text.set(color=INK, parse_math=False)


def legend_rows(curves: Sequence[Curve]) -> int:
    """How many rows the legend takes."""
    return math.ceil(len(curves) / _columns(curves))


def _named(curve: Curve) -> str:
    return f"{short(curve.label, LABEL_CHARACTERS - 12)} ({curve.runs} run{'s' if curve.runs > 1 else ''})"


def _columns(curves: Sequence[Curve]) -> int:
    widest = max(len(_named(curve)) for curve in curves)
    return max(1, min(len(curves), LABEL_CHARACTERS // (widest + 5)))


def short(label: str, characters: int) -> str:
    """The label, its middle left out where it is longer."""
    if len(label) <= characters:
        return label
    half = (characters - 3) // 2
    return f"{label[:half]}...{label[-half:]}"


def wrapped(label: str, characters: int, lines: int = 3) -> str:
    """The label in a few lines, for the side of an axis."""
    label = re.sub(r",\s*", ", ", label)  # lists may break between their entries
    text = textwrap.wrap(label, characters, break_on_hyphens=False) or [label]
    return "\n".join(text if len(text) <= lines else [*text[: lines - 1], "..." + label[3 - characters :]])


def return_curves(groups: Sequence[Group]) -> list[Curve]:
    """The interquartile mean over runs of the mean return of the last 20 episodes, by env steps.

    Each curve spans the frames in which all runs of its group have one: from the last of their first episodes' ends to
    the first of the runs' ends. Between two ends of episodes a run keeps its value; nothing is interpolated ahead.
    """
    driven = {group.label: [run for run in group.counted if run.ends.frames] for group in groups}
    last = max((run.summary["frames"] for runs in driven.values() for run in runs if run.summary), default=0)
    grid = np.linspace(0, last, POINTS)
    curves = []
    for label, runs in driven.items():
        if runs:
            begin = max(run.ends.frames[0] for run in runs)
            end = min(run.summary["frames"] for run in runs if run.summary)
            points = grid[(grid >= begin) & (grid <= end)]
            if len(points):
                rows = [_held(run.ends.frames, run.ends.mean_returns, points) for run in runs]
                curves.append(Curve(label, len(runs), points, iqm_band(np.stack(rows))))
    return curves


def lap_profiles(groups: Sequence[Group]) -> list[Curve]:
    """The share of runs that have lapped by each frame, up to where the first run of the group ended."""
    firsts = {group.label: values_of(group, FIRST_LAP_FRAMES) for group in groups}
    ends = {
        group.label: min((run.summary["frames"] for run in group.counted if run.summary), default=0) for group in groups
    }
    grid = np.linspace(0, max(ends.values(), default=0), POINTS)
    return [
        Curve(label, len(values), points, share_band(np.array(values)[:, None] <= points))
        for label, values in firsts.items()
        if values and len(points := grid[grid <= ends[label]])
    ]


def score_profiles(groups: Sequence[Group], measure: Measure) -> list[Curve]:
    """The share of runs above each score: the performance profiles of Agarwal et al. (2021)."""
    scores = {group.label: values_of(group, measure) for group in groups}
    pooled = [score for values in scores.values() for score in values if math.isfinite(score)]
    if not pooled:
        return []
    margin = 0.05 * (max(pooled) - min(pooled)) or 1.0
    grid = np.linspace(min(pooled) - margin, max(pooled) + margin, POINTS)
    return [
        Curve(label, len(values), grid, share_band(np.array(values)[:, None] > grid))
        for label, values in scores.items()
        if values
    ]


def _held(frames: Sequence[int], values: Sequence[float], points: Floats) -> Floats:
    """The value at the last of the frames that is not after each point, [T]."""
    held: Floats = np.asarray(values, dtype=np.float64)[np.searchsorted(frames, points, side="right") - 1]
    return held


def draw_returns(path: Path, groups: Sequence[Group]) -> bool:
    """Writes a PNG of every group's return against frames; False, and no file, where no run has episodes."""
    curves = return_curves(groups)
    if not curves:
        return False
    styles = looks(groups)
    figure = new_figure(height=3.6 + 0.17 * legend_rows(curves))
    axes = figure.subplots()
    plain_axes(axes)
    draw_curves(axes, curves, styles)
    axes.set_xlim(0, max(curve.points[-1] for curve in curves))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    count_frames(axes)
    name_axes(axes, "frames (env steps)", "return, mean of the last 20 episodes")
    _warn_of_scales(axes, groups)
    axes.set_title("interquartile mean, 95 % band", fontsize=7.5, color=FAINT, loc="right")
    name_groups(figure, curves, styles)
    save_figure(figure, path)
    return True


def draw_profiles(path: Path, groups: Sequence[Group]) -> bool:
    """Writes a PNG of performance profiles: who has lapped by when, and who ends above which return.

    Runs that learnt from logs have neither; of them the reward of the best drive is shown. False, and no file, if no
    run counts.
    """
    laps, returns = lap_profiles(groups), score_profiles(groups, FINAL_RETURN)
    rewards = [] if returns else score_profiles(groups, LAP_REWARD)
    panels = [curves for curves in (laps, returns, rewards) if curves]
    if not panels:
        return False
    styles = looks(groups)
    figure = new_figure(height=3.0 + 0.17 * legend_rows(panels[0]))
    for axes, curves in zip(figure.subplots(1, len(panels), squeeze=False).flat, panels, strict=True):
        _draw_profile(axes, curves, styles)
        if curves is laps:
            axes.set_xlim(left=0)
            count_frames(axes, ticks=5)
            name_axes(axes, "frames (env steps)", "share of runs that have lapped")
            axes.set_title("95 % bands", fontsize=7.5, color=FAINT, loc="right")
        else:
            what = "final return, mean of 20 episodes" if curves is returns else "reward of the best drive"
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
            axes.xaxis.set_major_locator(MaxNLocator(nbins=5))
            name_axes(axes, f"τ: {what}", "share of runs above τ")
            _warn_of_scales(axes, groups)
    name_groups(figure, max(panels, key=len), styles)
    save_figure(figure, path)
    return True


def _draw_profile(axes: Axes, curves: Sequence[Curve], styles: dict[str, Look]) -> None:
    plain_axes(axes)
    draw_curves(axes, curves, styles, steps=True)
    axes.set_xlim(min(curve.points[0] for curve in curves), max(curve.points[-1] for curve in curves))
    axes.set_ylim(-0.02, 1.04)
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))


def count_frames(axes: Axes, ticks: int = 6) -> None:
    """Writes env steps along the horizontal axis."""
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 5, 10]))


def _warn_of_scales(axes: Axes, groups: Sequence[Group]) -> None:
    if not FINAL_RETURN.is_on_one_scale(run for group in groups for run in group.counted):
        axes.set_title("rewards or tracks differ, and so do the scales", fontsize=7.5, color=FAINT, loc="left")


def name_axes(axes: Axes, horizontal: str, vertical: str) -> None:
    """What the two axes show."""
    axes.set_xlabel(horizontal, color=INK, fontsize=9)
    axes.set_ylabel(vertical, color=INK, fontsize=9)
