"""The learning curve: mean return per block of episodes, for one run or for many side by side.

Source: the paper's figure 3, "average reward per 20 episodes (during training)".
"""

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes

from carrl.render.curve_panel import RunCurve, block_means, common_bounds, draw_panel, legend_of
from carrl.render.figure import FAINT, INK, VERMILLION, new_figure, save_figure

__all__ = ["RunCurve", "block_means", "draw_learning_curve", "draw_learning_curves"]

MOST_COLUMNS = 5
MOST_TITLE_LINES = 3
TITLE_CHARACTERS = 90
"""As many fit beside each other into the figure's width."""


def draw_learning_curve(
    path: str | Path, episode_returns: Sequence[float], *, window: int = 20, first_lap_episode: int | None = None
) -> None:
    """Writes a picture of one run's learning curve.

    Args:
        path: where to write it, a .png, .pdf or .svg; the folder must exist.
        episode_returns: one per finished episode, in order, [E]; may be empty.
        window: episodes per mean.
        first_lap_episode: where to mark the greedy policy's first lap, counted from 1; None for no mark.
    """
    run = RunCurve(episode_returns, first_lap_episode)
    bounds = common_bounds([run], window)
    figure = new_figure(height=3.6)
    axes = figure.subplots()
    draw_panel(axes, run, window, bounds, size=1.0)
    if len(episode_returns) == 0:
        axes.set_yticks([])
    if first_lap_episode is not None:
        _label_first_lap(axes, first_lap_episode)
    axes.set_xlabel("episode", color=INK, fontsize=9)
    axes.set_ylabel("return per episode", color=INK, fontsize=9)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, **legend_of(window, bounds))
    save_figure(figure, path)


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


def _label_first_lap(axes: Axes, episode: int) -> None:
    """Writes beside the dashed line, on the side with more room, in the headroom above the returns."""
    on_the_right = episode < sum(axes.get_xlim()) / 2
    axes.annotate(
        f"first greedy lap: episode {episode:,}",
        (episode, 1),
        (6 if on_the_right else -6, -2),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        ha="left" if on_the_right else "right",
        va="top",
        fontsize=8.5,
        color=VERMILLION,
    )
