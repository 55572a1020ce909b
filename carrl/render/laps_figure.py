"""Laps beside each other in a picture: maps coloured by speed, speed and gap over the way, and where most is lost.

Shapes: `M` moments, `K` stations. Lengths are in metres.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from carrl.errors import printable
from carrl.racing.laps import Floats, Lap
from carrl.render.canvas import Canvas, Stroke, View
from carrl.render.colours import FAINT, INK, LAPS
from carrl.render.curves import WIDTH, add_drawing, new_figure, plain_axes, save_figure
from carrl.render.line_figure import draw_scale, draw_speed_bar, draw_speed_map
from carrl.render.scene import PRINT, Ground, draw_ground
from carrl.render.trail import speed_shades_of, speed_span
from carrl.tracks.track import Track

FLAT = 0.45
"""Height of a road by its width under which maps stand one above the other."""
MOST_BESIDE = 3
POINTS = 1000
"""Of a chart."""
WINDOW = 0.06
"""Share of the centreline that the close-up is about."""
ROADS_SEEN = 3.0
"""The close-up is at least so many widths of the road wide."""
_CHARTS, _BAR = 3.0, 0.55
"""Height of both charts, and of what explains the colours, inches."""
_CLOSE_UP = 0.34
"""Width of the close-up by that of the figure."""


def draw_laps(path: str | Path, track: Track, laps: Sequence[Lap]) -> None:
    """Writes a picture of laps, of which the first is the reference, a .png, .pdf or .svg.

    Raises:
        CarrlError: it ends in another, or cannot be written there.
    """
    ground = Ground.of(track)
    left, bottom, right, top = ground.bounds
    ratio = (top - bottom) / (right - left)
    columns = 1 if ratio < FLAT else min(len(laps), 2 if len(laps) in (2, 4) else MOST_BESIDE)
    rows = -(-len(laps) // columns)
    map_height = rows * (min(max(ratio, 0.2), 1.4) * WIDTH / columns + 0.25) + _BAR
    figure = new_figure(map_height + _CHARTS)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[map_height, _CHARTS]).flatten()
    _draw_maps(above, ground, laps, above.subplots(rows, columns, squeeze=False).flatten().tolist())
    _draw_below(below, ground, laps)
    save_figure(figure, path)


def _draw_maps(figure: Figure | SubFigure, ground: Ground, laps: Sequence[Lap], grid: Sequence[Axes]) -> None:
    low, high = speed_span(np.concatenate([lap.speed for lap in laps]))
    high = max(high, low + 1e-6)
    for axes in grid[len(laps) :]:
        axes.set_axis_off()
    for lap, axes, colour in zip(laps, grid, LAPS, strict=False):
        ways = np.stack([lap.poses[:-1, :2], lap.poses[1:, :2]], axis=1)
        draw_speed_map(axes, ground, ways, speed_shades_of(lap.speed[:-1], low, high))
        axes.set_title(_title(lap), fontsize=9, color=colour, fontweight="bold", parse_math=False)
    draw_scale(grid[0], ground)
    draw_speed_bar(figure, list(grid), low, high)


def _title(lap: Lap) -> str:
    time = f"ended at {lap.end[0]:,.0f} m" if lap.lap_time is None else f"{lap.lap_time:.2f} s"
    return f"{_short(lap.name, 30)}, {time}{', from rest' if lap.is_standing else ''}"


def _short(name: str, most: int) -> str:
    """The name, or as much of its beginning as so many characters hold."""
    name = printable(name)
    return name if len(name) <= most else f"{name[: most - 1]}…"


def _draw_below(figure: Figure | SubFigure, ground: Ground, laps: Sequence[Lap]) -> None:
    """Charts, and beside them, if there are several laps, the close-up."""
    stations = np.linspace(0, laps[0].length, POINTS)
    if len(laps) == 1:
        _draw_chart(figure.subplots(), laps, stations, [laps[0].speed_at(stations)], "speed, m/s", "distance, m")
        return
    grid = figure.subplot_mosaic(
        [["place", "speed"], ["place", "gap"]], width_ratios=[_CLOSE_UP, 1 - _CLOSE_UP], height_ratios=[1, 1]
    )
    gaps = [lap.gap_to(laps[0], stations) for lap in laps]
    _draw_chart(grid["speed"], laps, stations, [lap.speed_at(stations) for lap in laps], "speed, m/s")
    grid["speed"].tick_params(labelbottom=False)
    grid["speed"].set_ylim(bottom=0)
    _draw_chart(grid["gap"], laps, stations, gaps, "gap, s", "distance along the road, m")
    grid["gap"].annotate("up: behind", (0.01, 0.9), xycoords="axes fraction", fontsize=7, color=FAINT)
    begin, end = _costliest(stations, gaps[1])
    for name in ("speed", "gap"):
        grid[name].axvspan(begin, end, color="#000000", alpha=0.07, linewidth=0)
    _draw_close_up(grid["place"], ground, laps, begin, end)


def _draw_chart(
    axes: Axes, laps: Sequence[Lap], stations: Floats, lines: Sequence[Floats], label: str, below: str = ""
) -> None:
    plain_axes(axes)
    for lap, line, colour in reversed(list(zip(laps, lines, LAPS, strict=False))):
        axes.plot(stations, line, color=colour, linewidth=1.2, label=lap.name)
    axes.set_xlim(0, stations[-1])
    axes.set_ylabel(label, fontsize=8, color=INK)
    axes.set_xlabel(below, fontsize=8, color=INK)


def _costliest(stations: Floats, gaps: Floats) -> tuple[float, float]:
    """Where the stretch of `WINDOW` begins and ends in which a lap loses most to the reference, or gains least."""
    width = max(1, round(WINDOW * len(stations)))
    lost = np.nan_to_num(gaps[width:] - gaps[:-width], nan=-np.inf)
    begin = int(lost.argmax())
    return float(stations[begin]), float(stations[begin + width])


def _draw_close_up(axes: Axes, ground: Ground, laps: Sequence[Lap], begin: float, end: float) -> None:
    """The lines of all laps, each in its own colour, about a stretch of road."""
    ways = [_between(lap, begin, end) for lap in laps]
    points = np.concatenate([way for way in ways if len(way)])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    half = max(0.6 * float(np.ptp(points, axis=0).max()), ROADS_SEEN * _road_width(ground) / 2)
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal", anchor="C")
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(color=FAINT, linewidth=0.8)
    place = f"{begin:,.0f} to {end:,.0f} m"
    axes.set_title(f"{_short(laps[1].name, 18)} loses most: {place}", fontsize=8, color=LAPS[1], parse_math=False)

    def draw(canvas: Canvas, view: View) -> None:
        with canvas.clipped(view.area):
            draw_ground(canvas, view, ground, PRINT)
            for lap, colour in reversed(list(zip(laps, LAPS, strict=False))):
                canvas.line(view.places(lap.poses[:, :2]), Stroke(colour, 1.4))

    add_drawing(axes, draw)


def _road_width(ground: Ground) -> float:
    """At the start line, m."""
    return float(np.linalg.norm(ground.gates[-1, 0] - ground.gates[-1, 1]))


def _between(lap: Lap, begin: float, end: float) -> NDArray[np.float64]:
    """Places of a lap between two stations."""
    return np.asarray(lap.poses[(lap.station >= begin) & (lap.station <= end), :2])
