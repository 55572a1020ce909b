"""The learning curve: mean return per block of episodes, for one run or for many side by side.

Shapes: `E` episodes, `K` blocks. Returns are undiscounted sums of rewards; episodes are numbered from 1.

Source: the paper's figure 3, "average reward per 20 episodes (during training)".
"""

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
from numpy.typing import NDArray

from carrl.view.figure import BLUE, FAINT, INK, VERMILLION, new_figure, plain_axes, save_png

DOT = "#9a9a9a"
MOST_COLUMNS = 5
MOST_TITLE_LINES = 3
HEADROOM = 0.15
"""Share of the vertical axis kept free above the returns, where the first lap's label stands."""
_LEGEND: dict[str, Any] = {"ncols": 2, "frameon": False, "fontsize": 8.5}


@dataclass(frozen=True)
class RunCurve:
    """What the curve of one run shows.

    Attributes:
        episode_returns: one per finished episode, in order, [E].
        first_lap_episode: how many episodes had been driven when the greedy policy first lapped; None if it never did.
    """

    episode_returns: Sequence[float]
    first_lap_episode: int | None = None


def draw_learning_curve(
    path: str | Path, episode_returns: Sequence[float], *, window: int = 20, first_lap_episode: int | None = None
) -> None:
    """Writes a PNG of one run's learning curve.

    Args:
        path: where to write it; the folder must exist.
        episode_returns: one per finished episode, in order, [E]; may be empty.
        window: episodes per mean.
        first_lap_episode: where to mark the greedy policy's first lap; None for no mark.
    """
    run = RunCurve(episode_returns, first_lap_episode)
    figure = new_figure(height=3.6)
    axes = figure.subplots()
    _set_limits(axes, [run], window)
    _draw_run(axes, run, window, size=1.0)
    if first_lap_episode is not None:
        _label_first_lap(axes, first_lap_episode)
    axes.set_xlabel("episode", color=INK, fontsize=9)
    axes.set_ylabel("return per episode", color=INK, fontsize=9)
    axes.legend(handles=_legend_handles(window), loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, **_LEGEND)
    save_png(figure, path)


def draw_learning_curves(path: str | Path, runs: Mapping[str, RunCurve], *, window: int = 20) -> None:
    """Writes a PNG of many runs' learning curves as small multiples with common axes.

    Args:
        path: where to write it; the folder must exist.
        runs: label to run, in the order of the panels: row by row, at most five in a row.
        window: episodes per mean.

    Raises:
        ValueError: there is no run.
    """
    if not runs:
        raise ValueError("there is no run to draw; hand over at least one")
    rows, columns = _grid(len(runs))
    titles = [_wrap(label, characters=90 // columns) for label in runs]
    panel_height = (1.6 if columns > 2 else 2.2) + 0.14 * max(title.count("\n") + 1 for title in titles)
    figure = new_figure(height=0.75 + panel_height * rows)
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat)
    _set_limits(panels[0], runs.values(), window)
    for index, (axes, title, run) in enumerate(zip(panels, titles, runs.values(), strict=False)):
        _draw_run(axes, run, window, size=0.6)
        _title_panel(axes, title, run)
        axes.tick_params(labelbottom=index + columns >= len(runs), labelsize=7)
    for axes in panels[len(runs) :]:
        axes.set_visible(False)
    figure.supxlabel("episode", color=INK, fontsize=9)
    figure.supylabel("return per episode", color=INK, fontsize=9)
    figure.legend(handles=_legend_handles(window), loc="outside upper center", **_LEGEND)
    save_png(figure, path)


def block_means(returns: Sequence[float], window: int) -> NDArray[np.float64]:
    """Means of consecutive blocks of `window` returns, [E] to [K].

    A last incomplete block is left out, since its mean is noisier than the others, unless it is the only one.
    """
    blocks = max(1, len(returns) // window)
    starts = range(0, min(len(returns), blocks * window), window)
    return np.array([np.mean(returns[start : start + window]) for start in starts], dtype=np.float64)


def block_centres(episodes: int, window: int) -> NDArray[np.float64]:
    """The middle of each block of `block_means` on the axis of episodes, [K]: 10.5 for the episodes 1 to 20."""
    return block_means(range(1, episodes + 1), window)


def _draw_run(axes: Axes, run: RunCurve, window: int, size: float) -> None:
    """Single returns faintly, block means boldly, the first lap as a dashed line; `size` scales all marks."""
    plain_axes(axes)
    if run.first_lap_episode is not None:
        axes.axvline(run.first_lap_episode, color=VERMILLION, linewidth=1.2, linestyle=(0, (4, 2)), zorder=2.5)
    if len(run.episode_returns) == 0:
        axes.text(0.5, 0.5, "no finished episode", transform=axes.transAxes, ha="center", color=FAINT, fontsize=8)
        return
    _draw_single_returns(axes, np.asarray(run.episode_returns, dtype=np.float64), size)
    means = block_means(run.episode_returns, window)
    style = "o-" if len(means) <= 40 else "-"
    centres = block_centres(len(run.episode_returns), window)
    axes.plot(centres, means, style, color=BLUE, markersize=4 * size, linewidth=0.6 + size, zorder=3)


def _draw_single_returns(axes: Axes, returns: NDArray[np.float64], size: float) -> None:
    """A grey dot for each return, [E]; one outside the axis is a triangle at its edge, not dropped unseen."""
    low, high = axes.get_ylim()
    high -= HEADROOM / (1 + HEADROOM) * (high - low)
    episodes = np.arange(1, len(returns) + 1)
    # `low` and `high` themselves are edges of the frame, so triangles sit a little inside.
    edge = 0.012 * (high - low)
    shown = np.clip(returns, low + edge, high)
    for marker, chosen in {"v": returns < low, "^": returns > high, ".": (returns >= low) & (returns <= high)}.items():
        area = (14 if marker == "." else 18) * size
        axes.scatter(episodes[chosen], shown[chosen], s=area, c=DOT, marker=marker, alpha=0.45, linewidths=0, zorder=2)


def _set_limits(axes: Axes, runs: Iterable[RunCurve], window: int) -> None:
    """Axes that hold every block mean and 99 % of the single returns, so that a freak episode flattens no curve."""
    runs = list(runs)
    returns = np.concatenate([np.asarray(run.episode_returns, dtype=np.float64) for run in runs])
    episodes = max(max(len(run.episode_returns), run.first_lap_episode or 0) for run in runs)
    axes.set_xlim(0, max(episodes, 2) * 1.02)
    axes.xaxis.set_major_locator(MaxNLocator(nbins="auto", integer=True))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    if len(returns) == 0:
        axes.set_ylim(-1, 1)
        return
    means = np.concatenate([block_means(run.episode_returns, window) for run in runs])
    low = min(means.min(), np.quantile(returns, 0.005))
    high = max(means.max(), np.quantile(returns, 0.995))
    margin = 0.05 * (high - low) or 1.0
    low, high = low - margin, high + margin
    axes.set_ylim(low, high + HEADROOM * (high - low))


def _label_first_lap(axes: Axes, episode: int) -> None:
    """Writes beside the dashed line, on the side with more room, in the headroom above the returns."""
    on_the_right = episode < sum(axes.get_xlim()) / 2
    axes.annotate(
        f"first greedy lap: episode {episode:,}",
        (episode, 1),
        (6 if on_the_right else -6, -2),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        va="top",
        fontsize=8.5,
        ha="left" if on_the_right else "right",
        color=VERMILLION,
    )


def _title_panel(axes: Axes, title: str, run: RunCurve) -> None:
    """The run's title and, below it, whether and when it lapped."""
    lap = "no lap" if run.first_lap_episode is None else f"lap at episode {run.first_lap_episode:,}"
    colour = FAINT if run.first_lap_episode is None else VERMILLION
    axes.set_title(title, fontsize=8.5, color=INK, loc="left", pad=14, parse_math=False)
    axes.annotate(lap, (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points", fontsize=7, color=colour)


def _wrap(label: str, characters: int) -> str:
    """The label in lines of so many characters; of a long one the end, where the runs of a sweep differ."""
    lines = textwrap.wrap(label.replace(",", ", "), characters) or [""]
    if len(lines) > MOST_TITLE_LINES:
        lines = lines[-MOST_TITLE_LINES:]
        lines[0] = "..." + lines[0][3:]
    return "\n".join(lines)


def _legend_handles(window: int) -> list[Line2D]:
    """Marks larger and darker than those in the figure, which are faint for being many."""
    return [
        Line2D([], [], color=DOT, marker=".", markersize=6, linestyle="none", label="single episode"),
        Line2D([], [], color=BLUE, linewidth=1.6, label=f"mean of {window} episodes"),
    ]


def _grid(count: int) -> tuple[int, int]:
    """Rows and columns for so many panels, rows as equally full as can be."""
    rows = math.ceil(count / MOST_COLUMNS)
    return rows, math.ceil(count / rows)
