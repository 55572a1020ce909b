"""A reference line in a picture: the road with the line coloured by speed, and speed and controls over the distance.

Lengths are in metres.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from carrl.racing.reference_line import Floats, ReferenceLine
from carrl.render import round_number
from carrl.render.canvas import Canvas, View
from carrl.render.colours import BLUE, FAINT, INK, LIGHT, VERMILLION
from carrl.render.curves import add_drawing, new_figure, plain_axes, save_figure
from carrl.render.scene import PRINT, Ground, draw_ground, draw_line
from carrl.render.trail import speed_shades_of, speed_span
from carrl.tracks.track import Track

MOST_SHARE, LEAST_SHARE = 1.0, 0.35
"""Height of the map by the width of the figure, at most and at least."""
_PANEL, _MARGIN = 1.3, 0.04


def draw_line_figure(path: str | Path, track: Track, line: ReferenceLine, title: str) -> None:
    """Writes a picture of a line, a .png, .pdf or .svg.

    Raises:
        CarrlError: it ends in another, or cannot be written there.
    """
    ground = Ground.of(track)
    left, bottom, right, top = ground.bounds
    width, height = right - left, top - bottom
    map_height = 7 * min(max(height / width, LEAST_SHARE), MOST_SHARE)
    figure = new_figure(map_height + 3 * _PANEL + 0.6)
    grid = figure.subplot_mosaic(
        [["map"], ["speed"], ["acceleration"], ["steering"]], height_ratios=[map_height, _PANEL, _PANEL, _PANEL]
    )
    _draw_map(figure, grid["map"], ground, line)
    grid["map"].set_title(title, fontsize=10, color=INK, parse_math=False)
    closed = line.closed()
    _draw_profile(grid["speed"], closed.distance, closed.speed, "speed, m/s", INK)
    grid["speed"].set_ylim(bottom=0)
    _draw_steps(grid["acceleration"], closed.distance, closed.acceleration, "throttle and\nbrake, m/s²")
    _draw_profile(grid["steering"], closed.distance, closed.steering, "front wheels,\nrad to the left", BLUE)
    for name in ("speed", "acceleration"):
        grid[name].tick_params(labelbottom=False)
    grid["steering"].set_xlabel("distance driven from the start line, m", fontsize=8, color=INK)
    save_figure(figure, path)


def _draw_map(figure: Figure, axes: Axes, ground: Ground, line: ReferenceLine) -> None:
    low, high = speed_span(line.speed)
    high = max(high, low + 1e-6)
    ways = np.stack([line.places, np.roll(line.places, -1, axis=0)], axis=1)
    draw_speed_map(axes, ground, ways, speed_shades_of(line.speed, low, high))
    draw_speed_bar(figure, axes, low, high)
    draw_scale(axes, ground)


def draw_speed_map(axes: Axes, ground: Ground, ways: Floats, shades: NDArray[np.int64]) -> None:
    """Draws the road, and on it pieces of a line, [N, 2, 2], m, in these of the colours of speeds, [N]."""
    left, bottom, right, top = ground.bounds
    margin = _margin(ground)
    axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
    axes.set_axis_off()
    axes.set_aspect("equal", anchor="C")

    def draw(canvas: Canvas, view: View) -> None:
        draw_ground(canvas, view, ground, PRINT)
        draw_line(canvas, view, ways, shades, LIGHT.speed_shades, 1.6)

    add_drawing(axes, draw)


def draw_speed_bar(figure: Figure | SubFigure, axes: Axes | list[Axes], low: float, high: float) -> None:
    """Draws below the maps what their colours mean, from the least to the greatest speed, m/s."""
    colours = ScalarMappable(Normalize(low, high), ListedColormap(list(LIGHT.speed_shades)))
    bar = figure.colorbar(colours, ax=axes, orientation="horizontal", shrink=0.4, aspect=40, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7, colors=FAINT, labelcolor=INK, length=2)
    bar.set_label("speed, m/s", fontsize=8, color=INK)


def draw_scale(axes: Axes, ground: Ground) -> None:
    """Draws a bar of a round number of metres below a map."""
    left, bottom, right, _ = ground.bounds
    metres = round_number((right - left) / 12)
    begin = left, bottom - 0.9 * _margin(ground)
    axes.plot([begin[0], begin[0] + metres], [begin[1], begin[1]], color=INK, linewidth=1)
    axes.annotate(
        f"{metres:,g} m", (begin[0] + metres, begin[1]), (4, 0), textcoords="offset points", fontsize=7, va="center"
    )


def _margin(ground: Ground) -> float:
    left, bottom, right, top = ground.bounds
    return _MARGIN * max(right - left, top - bottom)


def _draw_profile(axes: Axes, distance: np.ndarray, values: np.ndarray, label: str, colour: str) -> None:
    _prepare(axes, distance, label)
    axes.plot(distance, values, color=colour, linewidth=1)


def _draw_steps(axes: Axes, distance: np.ndarray, values: np.ndarray, label: str) -> None:
    """Above 0 in one colour, below in another."""
    _prepare(axes, distance, label)
    for shown, colour in ((values.clip(min=0), BLUE), (values.clip(max=0), VERMILLION)):
        axes.fill_between(distance, shown, step="post", color=colour, linewidth=0)


def _prepare(axes: Axes, distance: np.ndarray, label: str) -> None:
    plain_axes(axes)
    axes.set_xlim(0, distance[-1])
    axes.set_ylabel(label, fontsize=8, color=INK)
