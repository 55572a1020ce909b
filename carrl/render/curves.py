"""Diagrams, and learning curves: evaluations against env steps, and the paper's figure 3 beside them.

In figure 3 returns are faint, and means of blocks of episodes bold.

Shapes: `E` episodes, numbered from 1, `K` blocks. Returns are undiscounted sums of rewards.
"""

import math
import re
import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
from numpy.typing import NDArray
from PIL import Image

from carrl.files import write_whole
from carrl.render import picture_format
from carrl.render.canvas import Area, Canvas, PixelCanvas, View
from carrl.render.colours import BLUE, FAINT, INK, PAPER, VERMILLION

WIDTH = 7.0
"""Width of a figure, inches."""
DPI = 130
"""Pixels per inch: a figure is 910 pixels wide, about as wide as a README."""
_UNDATED = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""The same figure gives the same bytes."""


def new_figure(height: float) -> Figure:
    """A white figure of the common width, height in inches, in no window and no global state."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain_axes(axes: Axes) -> None:
    """Gives axes of a diagram two thin spines, small ticks and faint horizontal lines."""
    axes.set_facecolor("white")
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set(color=FAINT, linewidth=0.8)
    axes.tick_params(colors=FAINT, labelcolor=INK, labelsize=8, width=0.8, length=3)
    axes.grid(axis="y", color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes the figure to `path`, whole or not at all: a reader sees the old picture or the new one.

    The format is that which the name ends in: .png, .pdf or .svg.

    Raises:
        CarrlError: it ends in another, or cannot be written there.
    """
    kind, picture = picture_format(path), BytesIO()
    figure.savefig(picture, format=kind, dpi=DPI, facecolor="white", metadata=_UNDATED.get(kind))
    write_whole(path, picture.getvalue())


def save_drawing(path: str | Path, size: tuple[float, float], draw: Callable[[Canvas], None]) -> None:
    """Writes what is drawn on a canvas of this size, points, as `save_figure` does."""
    if picture_format(path) != "png":
        figure = Figure(figsize=(size[0] / 72, size[1] / 72))
        figure.add_artist(_Drawing(draw))
        save_figure(figure, path)
        return
    canvas, file = PixelCanvas(*size, scale=DPI / 72), BytesIO()
    canvas.clear(PAPER)
    draw(canvas)
    Image.fromarray(canvas.picture()).save(file, format="PNG", dpi=(DPI, DPI))
    write_whole(path, file.getvalue())


def add_drawing(axes: Axes, draw: Callable[[Canvas, View], None]) -> None:
    """Draws on axes in metres, of equal scales, below everything else there; the units are points."""
    axes.add_artist(_Drawing(lambda canvas: draw(canvas, _view_of(axes))))


def _view_of(axes: Axes) -> View:
    """What axes show, in points of their figure."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    figure = cast(Figure, axes.get_figure(root=True))
    box, points = axes.get_window_extent(), 72 / figure.dpi
    area = Area(box.x0 * points, (figure.bbox.height - box.y1) * points, box.width * points, box.height * points)
    return View(area, np.array([left + right, bottom + top]) / 2, area.width / (right - left))


class _Drawing(Artist):
    """A drawing as a part of one of Matplotlib's figures, whose units are points."""

    def __init__(self, draw: Callable[[Canvas], None]) -> None:
        super().__init__()
        self._draw_on = draw

    def draw(self, renderer: RendererBase) -> None:
        scale: Any = renderer.points_to_pixels(1)
        self._draw_on(Canvas(renderer, float(scale)))


DOT = "#9a9a9a"
HEADROOM = 0.15
"""Share of the vertical axis added above the returns, where the first lap's label stands."""
FEW_EPISODES = 200
"""Dots so few that they need not be faint."""
FEW_BLOCKS = 40
"""Up to so many block means, each has a dot of its own."""
MOST_COLUMNS = 5
MOST_TITLE_LINES = 3
TITLE_CHARACTERS = 90
"""As many fit beside each other into the figure's width."""


@dataclass(frozen=True)
class RunCurve:
    """What the curve of one run shows.

    Attributes:
        episode_returns: one per finished episode, in order, [E].
        first_lap_episode: how many episodes had been driven at the first confirmed greedy lap; None if there was none.
    """

    episode_returns: Sequence[float]
    first_lap_episode: int | None = None


@dataclass(frozen=True)
class EvaluationCurve:
    """How a run's networks drove without exploration as they were tried out in training.

    Attributes:
        frames: env steps of the run by then, [N].
        values: of the drives, [N].
        laps: share of the drives that completed the lap, [N].
        name: what the values are.
        first_lap_frame: env steps at the first confirmed lap; None if there was none.
    """

    frames: Sequence[int]
    values: Sequence[float]
    laps: Sequence[float]
    name: str
    first_lap_frame: int | None = None


@dataclass(frozen=True)
class Bounds:
    """The part of the plane that a panel shows.

    Attributes:
        low: least return shown.
        high: greatest return shown, below the headroom.
        last_episode: right end of the axis of episodes.
        outside: whether a single return lies below or above.
    """

    low: float
    high: float
    last_episode: float
    outside: bool


def block_means(returns: Sequence[float], window: int) -> NDArray[np.float64]:
    """Means of consecutive blocks of `window` returns, the last of which may be shorter, [E] to [K]."""
    starts = range(0, len(returns), window)
    return np.array([np.mean(returns[start : start + window]) for start in starts], dtype=np.float64)


def block_centres(episodes: int, window: int) -> NDArray[np.float64]:
    """The middle of each block of `block_means` on the axis of episodes, [K]: 10.5 for the episodes 1 to 20."""
    return block_means(range(1, episodes + 1), window)


def common_bounds(runs: Collection[RunCurve], window: int) -> Bounds:
    """Bounds that hold every block mean and 99 % of the single returns, so that a freak episode flattens no curve."""
    returns = np.concatenate([np.asarray(run.episode_returns, dtype=np.float64) for run in runs])
    last_episode = 1.02 * max(window, *(max(len(run.episode_returns), run.first_lap_episode or 0) for run in runs))
    if len(returns) == 0:
        return Bounds(-1, 1, last_episode, outside=False)
    means = np.concatenate([block_means(run.episode_returns, window) for run in runs])
    low = min(means.min(), np.quantile(returns, 0.005))
    high = max(means.max(), np.quantile(returns, 0.995))
    margin = 0.05 * (high - low) or max(1.0, 0.1 * abs(high))
    low, high = low - margin, high + margin
    return Bounds(low, high, last_episode, outside=bool(((returns < low) | (returns > high)).any()))


def draw_panel(axes: Axes, run: RunCurve, window: int, bounds: Bounds, size: float) -> None:
    """Draws a run into axes that are set to the bounds; `size` scales the marks."""
    plain_axes(axes)
    _set_scales(axes, bounds)
    if run.first_lap_episode is not None:
        axes.axvline(run.first_lap_episode, color=VERMILLION, linewidth=1.2, linestyle=(0, (4, 2)), zorder=2.5)
    if len(run.episode_returns) == 0:
        axes.text(0.5, 0.5, "no finished episode", transform=axes.transAxes, ha="center", color=FAINT, fontsize=8)
        return
    _draw_single_returns(axes, np.asarray(run.episode_returns, dtype=np.float64), bounds, size)
    means = block_means(run.episode_returns, window)
    style = "o-" if len(means) <= FEW_BLOCKS else "-"
    centres = block_centres(len(run.episode_returns), window)
    axes.plot(centres, means, style, color=BLUE, markersize=4 * size, linewidth=0.6 + size, zorder=3)


def legend_of(window: int, bounds: Bounds) -> dict[str, Any]:
    """What to hand to `legend`: marks larger and darker than those in the panels, which are faint for being many."""
    dot: dict[str, Any] = {"color": DOT, "linestyle": "none"}
    handles = [
        Line2D([], [], marker=".", markersize=6, label="single episode", **dot),
        Line2D([], [], color=BLUE, linewidth=1.6, label=f"mean of {window} episodes"),
    ]
    if bounds.outside:
        handles.append(Line2D([], [], marker="^", markersize=5, label="single episode off the scale", **dot))
    return {"handles": handles, "ncols": len(handles), "frameon": False, "fontsize": 8.5}


def _set_scales(axes: Axes, bounds: Bounds) -> None:
    axes.set_xlim(0, bounds.last_episode)
    axes.set_ylim(bounds.low, bounds.high + HEADROOM * (bounds.high - bounds.low))
    axes.xaxis.set_major_locator(MaxNLocator(nbins="auto", steps=[1, 2, 5, 10], integer=True))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))


def _draw_single_returns(axes: Axes, returns: NDArray[np.float64], bounds: Bounds, size: float) -> None:
    """A dot for each return, [E]; one out of bounds is a triangle at the edge, not dropped unseen."""
    episodes = np.arange(1, len(returns) + 1)
    # The lower bound is the frame itself, so triangles stand a little above it.
    shown = np.clip(returns, bounds.low + 0.012 * (bounds.high - bounds.low), bounds.high)
    below, above = returns < bounds.low, returns > bounds.high
    alpha = 0.9 if len(returns) <= FEW_EPISODES else 0.45
    for marker, chosen, area in ((".", ~(below | above), 14), ("v", below, 18), ("^", above, 18)):
        axes.scatter(
            episodes[chosen], shown[chosen], s=area * size, c=DOT, marker=marker, alpha=alpha, linewidths=0, zorder=2
        )


def draw_learning_curve(
    path: str | Path,
    episode_returns: Sequence[float],
    *,
    window: int = 20,
    first_lap_episode: int | None = None,
    evaluations: EvaluationCurve | None = None,
) -> None:
    """Writes a picture of one run's learning: its evaluations, if there are several, and the returns of its episodes.

    Args:
        path: where to write it, a .png, .pdf or .svg; the folder must exist.
        episode_returns: one per finished episode, in order, [E]; may be empty.
        window: episodes per mean.
        first_lap_episode: where to mark the greedy policy's first lap, counted from 1; None for no mark.
        evaluations: of its networks in training.
    """
    run = RunCurve(episode_returns, first_lap_episode)
    bounds = common_bounds([run], window)
    figure = new_figure(height=3.6)
    if evaluations is not None and len(evaluations.frames) > 1:
        left, axes = figure.subplots(1, 2, width_ratios=(3, 2))
        _draw_evaluations(left, evaluations)
    else:
        axes = figure.subplots()
    draw_panel(axes, run, window, bounds, size=1.0)
    if len(episode_returns) == 0:
        axes.set_yticks([])
    if first_lap_episode is not None and len(figure.axes) == 1:
        _label_first_lap(axes, first_lap_episode, "episode")
    axes.set_xlabel("episode", color=INK, fontsize=9)
    axes.set_ylabel("return per episode", color=INK, fontsize=9)
    legend = legend_of(window, bounds) | ({"ncols": 1} if len(figure.axes) > 1 else {})
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, **legend)
    save_figure(figure, path)


def _draw_evaluations(axes: Axes, curve: EvaluationCurve) -> None:
    """The values against env steps, with a filled mark where all drives completed the lap."""
    plain_axes(axes)
    frames, values = np.asarray(curve.frames), np.asarray(curve.values, dtype=np.float64)
    complete = np.asarray(curve.laps) >= 1
    size = 18 if len(frames) <= FEW_BLOCKS else 7
    axes.plot(frames, values, "-", color=BLUE, linewidth=1.2, zorder=2)
    for chosen, fill, label in ((complete, BLUE, "every lap completed"), (~complete, PAPER, "not every lap")):
        if chosen.any():
            axes.scatter(
                frames[chosen], values[chosen], s=size, facecolors=fill, edgecolors=BLUE, zorder=3, label=label
            )
    axes.set_xlim(0, 1.02 * frames[-1])
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + HEADROOM * (high - low))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))
    if curve.first_lap_frame is not None:
        axes.axvline(curve.first_lap_frame, color=VERMILLION, linewidth=1.2, linestyle=(0, (4, 2)), zorder=1.5)
        _label_first_lap(axes, curve.first_lap_frame, "env step")
    axes.set_xlabel("env steps", color=INK, fontsize=9)
    axes.set_ylabel(f"evaluation: {curve.name}", color=INK, fontsize=9)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, frameon=False, fontsize=8.5)


def draw_learning_curves(path: str | Path, runs: Mapping[str, RunCurve], *, window: int = 20) -> None:
    """Writes a picture of many runs' learning curves as small multiples with common axes.

    Args:
        path: where to write it, a .png, .pdf or .svg; the folder must exist.
        runs: label to run, in the order of the panels: row by row, at most five in a row.
        window: episodes per mean.

    Raises:
        ValueError: there is no run.
    """
    if not runs:
        raise ValueError("there is no run to draw; hand over at least one")
    bounds = common_bounds(runs.values(), window)
    rows, columns = _grid(len(runs))
    titles = [_wrap(label, TITLE_CHARACTERS // columns) for label in runs]
    panel_height = (1.6 if columns > 2 else 2.2) + 0.14 * max(title.count("\n") + 1 for title in titles)
    figure = new_figure(height=0.75 + panel_height * rows)
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat)
    for index, (axes, title, run) in enumerate(zip(panels, titles, runs.values(), strict=False)):
        draw_panel(axes, run, window, bounds, size=0.6)
        _title_panel(axes, title, run)
        axes.tick_params(labelbottom=index + columns >= len(runs), labelsize=7)
    for axes in panels[len(runs) :]:
        axes.set_visible(False)
    figure.supxlabel("episode", color=INK, fontsize=9)
    figure.supylabel("return per episode", color=INK, fontsize=9)
    figure.legend(loc="outside upper center", **legend_of(window, bounds))
    save_figure(figure, path)


def _grid(count: int) -> tuple[int, int]:
    """Rows and columns for so many panels, rows as equally full as can be."""
    rows = math.ceil(count / MOST_COLUMNS)
    return rows, math.ceil(count / rows)


def _wrap(label: str, characters: int) -> str:
    """The label in lines of so many characters; of a long one the end, where the runs of a sweep differ."""
    lines = textwrap.wrap(re.sub(r",\s*", ", ", label), characters) or [""]
    if len(lines) > MOST_TITLE_LINES:
        lines = lines[-MOST_TITLE_LINES:]
        lines[0] = "..." + lines[0][3:]
    return "\n".join(lines)


def _title_panel(axes: Axes, title: str, run: RunCurve) -> None:
    """The run's title and, below it, whether and when it lapped."""
    lap = "no lap" if run.first_lap_episode is None else f"first lap: episode {run.first_lap_episode:,}"
    colour = FAINT if run.first_lap_episode is None else VERMILLION
    axes.set_title(title, fontsize=8.5, color=INK, loc="left", pad=14, parse_math=False)
    axes.annotate(lap, (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points", fontsize=7, color=colour)


def _label_first_lap(axes: Axes, at: int, unit: str) -> None:
    """Writes beside the dashed line, on the side with more room, in the headroom above the returns."""
    on_the_right = at < sum(axes.get_xlim()) / 2
    axes.annotate(
        f"first confirmed lap: {unit} {at:,}",
        (at, 1),
        (6 if on_the_right else -6, -2),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        ha="left" if on_the_right else "right",
        va="top",
        fontsize=8.5,
        color=VERMILLION,
    )
