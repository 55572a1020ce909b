"""One panel of a learning curve: single returns faintly, their block means boldly, the first lap as a dashed line.

Shapes: `E` episodes, `K` blocks. Returns are undiscounted sums of rewards; episodes are numbered from 1.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
from numpy.typing import NDArray

from carrl.render.figure import BLUE, FAINT, VERMILLION, plain_axes

DOT = "#9a9a9a"
HEADROOM = 0.15
"""Share of the vertical axis added above the returns, where the first lap's label stands."""
FEW_BLOCKS = 40
"""Up to so many block means, each has a dot of its own."""


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
    """Means of consecutive blocks of `window` returns, [E] to [K].

    A last incomplete block is left out, since its mean is noisier than the others, unless it is the only one.
    """
    blocks = max(1, len(returns) // window)
    starts = range(0, min(len(returns), blocks * window), window)
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
    for marker, chosen, area in ((".", ~(below | above), 14), ("v", below, 18), ("^", above, 18)):
        axes.scatter(
            episodes[chosen], shown[chosen], s=area * size, c=DOT, marker=marker, alpha=0.45, linewidths=0, zorder=2
        )
