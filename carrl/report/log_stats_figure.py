"""The statistics of a log as one picture: returns, lengths, actions, and where on the track cars crashed.

Shapes: `E` episodes, `A` actions, `G` gates.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter, StrMethodFormatter
from numpy.typing import NDArray

from carrl.errors import CarrlError, printable
from carrl.log.scene import TrackShape
from carrl.render import round_number, span
from carrl.render.canvas import Canvas, View
from carrl.render.colours import BLUE, FAINT, GREEN, INK, LIGHT, PURPLE, VERMILLION, YELLOW
from carrl.render.curves import (
    RunCurve,
    add_drawing,
    common_bounds,
    draw_panel,
    legend_of,
    new_figure,
    plain_axes,
    save_figure,
)
from carrl.render.scene import PRINT, Ground, draw_ground, number_gates
from carrl.report.log_stats import CONTROL_EDGES, NO_EPISODE, LogStats, crowding, distinct

HEIGHT = 6.6
"""Of the figure, inches."""
FEW_EPISODES, MOST_BLOCKS = 20, 100
"""Episodes per mean of the curve, at least, and means, about."""
SQUARES, DOTS_PER_SQUARE = 40, 5
"""Along the longer side of the track, places to count crashes in, about; and dots along such a place, at most."""
FEW = 5
"""So many crashes in one place are never drawn as many."""
MOST_GATE_NUMBERS = 16
FEW_TO_MANY = LinearSegmentedColormap.from_list("few to many", [YELLOW, VERMILLION, "#3d0c00"])


def draw_log_stats(path: str | Path, stats: LogStats, title: str) -> None:
    """Writes a PNG of a log's statistics.

    Args:
        path: where to write it; the folder must exist.
        stats: of the log.
        title: one line above the panels.

    Raises:
        CarrlError: no episode has ended.
    """
    if not len(stats):
        raise CarrlError(f"{NO_EPISODE}; let the run go on until one has")
    figure = new_figure(HEIGHT)
    figure.suptitle(title, fontsize=11, color=INK, parse_math=False)
    panels = figure.subplot_mosaic(
        [["returns", "returns", "lengths"], ["actions", "map", "map"]], height_ratios=[4, 5], width_ratios=[1, 1, 1]
    )
    _draw_returns(panels["returns"], stats)
    _draw_lengths(panels["lengths"], stats)
    _draw_actions(panels["actions"], stats)
    _draw_crashes(figure, panels["map"], stats)
    save_figure(figure, path)


def _title(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=9, color=INK, loc="left", parse_math=False)


def _draw_returns(axes: Axes, stats: LogStats) -> None:
    run = RunCurve(stats.returns.tolist())
    window = max(FEW_EPISODES, round(round_number(len(stats) / MOST_BLOCKS)))
    bounds = common_bounds([run], window)
    draw_panel(axes, run, window, bounds, size=0.6 if len(stats) < 5_000 else 0.25)
    axes.legend(loc="upper left", **legend_of(window, bounds) | {"fontsize": 7, "handletextpad": 0.3})
    axes.set_xlabel("episode", fontsize=8, color=INK)
    _title(axes, "return per episode")


def _draw_lengths(axes: Axes, stats: LogStats) -> None:
    """Stacked by how the episodes ended."""
    plain_axes(axes)
    names = list(stats.ends_counted)
    ends = [stats.lengths[stats.ended == name] for name in names]
    edges = np.linspace(*span(float(stats.lengths.min()), float(stats.lengths.max())), 25).tolist()
    axes.hist(ends, edges, stacked=True, color=[VERMILLION, BLUE, YELLOW][: len(names)], label=names)
    axes.set_ylim(top=1.25 * axes.get_ylim()[1])
    axes.legend(frameon=False, fontsize=7, handlelength=1, loc="upper right")
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
    axes.set_xlabel("steps", fontsize=8, color=INK)
    _title(axes, "length of an episode")


def _draw_actions(axes: Axes, stats: LogStats) -> None:
    """How often each action was chosen, or where actions are numbers, how often each control lay where."""
    plain_axes(axes)
    random = f", {100 * stats.exploratory_share:.0f} % at random" if stats.exploratory_share >= 0 else ""
    if stats.control_counts is not None:
        _draw_controls(axes, stats, stats.control_counts)
        _title(axes, f"controls{random}")
        return
    shares = stats.action_counts / max(1, stats.action_counts.sum())
    rows = np.arange(len(shares))
    axes.barh(rows, shares, color=LIGHT.action_colours(len(shares)), height=0.55)
    for row, share in zip(rows, shares, strict=True):
        axes.annotate(
            f"{100 * share:.0f} %", (share, row), (4, 0), textcoords="offset points", va="center", fontsize=8, color=INK
        )
    axes.set_yticks(rows, stats.scene.action_names)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.set_xlim(0, 1.25 * max(shares.max(), 1e-9))
    axes.xaxis.set_major_formatter(PercentFormatter(1, decimals=0, symbol=" %"))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=3))
    axes.set_xlabel(f"of {stats.action_counts.sum():,} steps", fontsize=8, color=INK)
    _title(axes, f"actions{random}")


def _draw_controls(axes: Axes, stats: LogStats, counts: NDArray[np.int64]) -> None:
    """The share of the steps in which each control lay between two edges, as a line of steps."""
    colours = (BLUE, VERMILLION, GREEN, PURPLE)
    for index, (name, count) in enumerate(zip(stats.scene.control_names, counts, strict=True)):
        shares, colour = count / max(1, count.sum()), colours[index % len(colours)]
        axes.stairs(shares, CONTROL_EDGES, color=colour, linewidth=1.6, label=printable(name), baseline=None)
    axes.set_ylim(0, 1.3 * axes.get_ylim()[1])
    axes.legend(frameon=False, fontsize=7, handlelength=1.2, loc="upper right", ncols=len(counts))
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0, symbol=" %"))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4))
    axes.set_xticks([-1, 0, 1])
    axes.set_xlabel(f"control, of {stats.action_counts.sum():,} steps", fontsize=8, color=INK)


def _draw_crashes(figure: Figure, axes: Axes, stats: LogStats) -> None:
    """Dots where cars crashed, coloured by how many did so near there."""
    _draw_track(axes, stats.track)
    off = f", {stats.off_the_map:,} off the map" * (stats.off_the_map > 0)
    _title(axes, f"{len(stats.crashes):,} crashes on {stats.track_note}{off}")
    if not len(stats.crash_places):
        return
    left, bottom, right, top = stats.track.bounds
    side = round_number(max(right - left, top - bottom) / SQUARES)
    places = stats.crash_places
    crowds = crowding(places, side)
    shown = distinct(places, side / DOTS_PER_SQUARE)
    shown = shown[np.argsort(crowds[shown])]
    x, y = places[shown].T
    dots = axes.scatter(
        x, y, c=crowds[shown], cmap=FEW_TO_MANY, vmin=0, vmax=max(FEW, crowds.max()), s=9, linewidths=0, zorder=5
    )
    bar = figure.colorbar(dots, ax=axes, orientation="horizontal", shrink=0.6, aspect=40, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7, colors=FAINT, labelcolor=INK, length=2)
    bar.ax.xaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    bar.ax.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    bar.set_label(f"crashes in the same square of {side:g} m", fontsize=7.5, color=INK)


def _draw_track(axes: Axes, track: TrackShape) -> None:
    """The road, its walls, its numbered gates and the start line."""
    ground = Ground.of(track)
    left, bottom, right, top = ground.bounds
    margin = 0.06 * max(right - left, top - bottom)
    axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
    axes.set_axis_off()
    axes.set_aspect("equal", anchor="S")

    def draw(canvas: Canvas, view: View) -> None:
        draw_ground(canvas, view, ground, PRINT)
        number_gates(canvas, view, ground.gates, 7, MOST_GATE_NUMBERS, FAINT)

    add_drawing(axes, draw)
