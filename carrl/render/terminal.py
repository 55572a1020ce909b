"""Charts and bars of characters: braille dots in colour on a terminal, letters in plain text.

Shapes: `N` points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import plotext
from numpy.typing import ArrayLike, NDArray
from rich.bar import Bar
from rich.color import Color
from rich.console import Console, Group
from rich.style import Style
from rich.table import Table
from rich.text import Text

from carrl.log.scene import TrackShape
from carrl.render import round_ticks, step_between
from carrl.render.colours import DARK, rgb
from carrl.render.episode import connected_walls

Bounds = tuple[float, float]
DOTS = 2, 4
"""Dots of a braille character, across and down; they stand as far apart both ways, as characters are high."""


@dataclass(frozen=True)
class Ink:
    """What a point is drawn with.

    Attributes:
        symbol: a character, or `braille` for a dot that is finer than one.
        colour: None for the terminal's own, which is readable on its background, whatever that is.
    """

    symbol: str
    colour: str | None = None

    @property
    def style(self) -> Style:
        """The colour, for rich."""
        return Style(color=Color.from_rgb(*rgb(self.colour))) if self.colour else Style()

    def sample(self, name: str) -> Text:
        """A piece for a legend."""
        stroke = "━━" if self.symbol == "braille" else self.symbol
        return Text.assemble((stroke, self.style), f" {name}")


def shows_colours(console: Console) -> bool:
    """Whether what is printed can be told apart by its colour."""
    return console.color_system is not None and not console.no_color


def action_inks(names: Sequence[str], coloured: bool) -> list[Ink]:
    """An ink for each action: its colour, or else the first letter of its name that is still free."""
    if coloured:
        colours = (None, *DARK.actions[1:])
        return [Ink("braille", colours[action % len(colours)]) for action in range(len(names))]
    letters: list[str] = []
    for name in names:
        letters.append(next((letter for letter in name + "0123456789" if letter not in letters), "?"))
    return [Ink(letter) for letter in letters]


def speed_inks(coloured: bool) -> list[Ink]:
    """From the least to the greatest speed: colours, or else a digit for each tenth."""
    return [Ink("braille", colour) for colour in DARK.speeds] if coloured else [Ink(digit) for digit in "0123456789"]


class Chart:
    """An empty chart, `width` characters wide and `height` lines high, title and axes included."""

    def __init__(self, width: int, height: int, title: str | None = None) -> None:
        self._width, self._height = width, height
        self._bounds: tuple[Bounds, Bounds] = (-math.inf, math.inf), (-math.inf, math.inf)
        # plotext's own figure and terminal are one for the whole process; these are nobody else's.
        terminal = type(plotext.terminal)().limit(False, False)
        self._figure = type(plotext.figure)(terminal).theme("colorless").plot_size(width, height).title(title)
        self._figure.axes(False, axis="x", side="upper").axes(False, axis="y", side="right")

    def line(
        self, x: ArrayLike, y: ArrayLike, ink: Ink | Sequence[Ink], joined: bool | NDArray[np.bool_] = True
    ) -> Self:
        """Draws points, but none that is infinite, no number or outside of what the chart shows.

        Args:
            x: of each point, [N].
            y: of each point, [N].
            ink: one for all points, or one for each, which is also that of the line to the next point.
            joined: whether a line leads to each point from the one before, for all points or for each, [N].
        """
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        inks = [ink] * len(x) if isinstance(ink, Ink) else list(ink)
        inside = self._is_inside(x, y)
        shown = np.flatnonzero(inside)
        if not len(shown):  # plotext 6.1 divides by their number
            return self
        markers = {ink: _marker(ink) for ink in set(inks)}
        signal = self._figure.signal(
            x[shown].tolist(), y[shown].tolist(), marker=[markers[inks[point]] for point in shown]
        )
        # A line to a point far outside would be drawn dot by dot, however many that are.
        outside = np.isfinite(x) & np.isfinite(y) & ~inside
        is_joined_to = np.broadcast_to(joined, len(x)) & ~np.append(False, outside[:-1])
        for index, is_joined in enumerate(is_joined_to[shown].tolist()):
            signal.line(index, is_joined)
        self._figure.draw(signal)
        return self

    def axes(self, x: Bounds, y: Bounds) -> Self:
        """Sets what the axes show, with round numbers beside them."""
        self._bounds = x, y
        for name, (low, high), most in (("x", x, self._width // 12), ("y", y, self._height // 3)):
            ticks = round_ticks(low, high, max(1, most))
            self._figure.ruler(name).lim(low, high).ticks(ticks, [f"{tick:,.10g}" for tick in ticks])
        return self

    def bare(self, x: Bounds, y: Bounds) -> Self:
        """Sets what the whole chart shows, from edge to edge, without axes."""
        self._bounds = x, y
        self._figure.axes(False)
        for name, bounds in (("x", x), ("y", y)):
            self._figure.ruler(name).lim(*bounds).alignment(lim="edge").frequency(0)
        return self

    def _is_inside(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        (left, right), (bottom, top) = self._bounds
        return np.isfinite(x) & np.isfinite(y) & (left <= x) & (x <= right) & (bottom <= y) & (y <= top)

    def text(self) -> Text:
        """The chart as lines of characters."""
        return Text.from_ansi(self._figure.build().string(False).rstrip("\n"), no_wrap=True)


def map_chart(track: TrackShape, width: int, height: int, ink: Ink) -> Chart:
    """A map of a track's walls, not distorted, at most so many characters wide and lines high."""
    left, bottom, right, top = track.bounds
    # Metres per dot; a margin of one dot keeps the outermost walls inside.
    scale = max((right - left) / (DOTS[0] * width - 2), (top - bottom) / (DOTS[1] * height - 2))
    columns, rows = (
        math.ceil(((right - left) / scale + 1) / DOTS[0]),
        math.ceil(((top - bottom) / scale + 1) / DOTS[1]),
    )
    half = columns * DOTS[0] * scale / 2, rows * DOTS[1] * scale / 2
    middle = (left + right) / 2, (bottom + top) / 2
    chart = Chart(columns, rows).bare(
        (middle[0] - half[0], middle[0] + half[0]), (middle[1] - half[1], middle[1] + half[1])
    )
    for wall in connected_walls(track):
        chart.line(wall[:, 0], wall[:, 1], ink)
    return chart


def _marker(ink: Ink) -> plotext.marker:
    if ink.colour is None:
        return plotext.marker(ink.symbol)
    return plotext.marker(ink.symbol, pixel=plotext.pixel(foreground=tuple(rgb(ink.colour))))


PLAIN = Ink("braille")
LEAST_WIDTH = 10
"""Of the longest bar, characters."""
FIGURES = 18
"""Room for a count and its share, characters."""


@dataclass(frozen=True)
class BarRow:
    """One bar: what it counts, how many of these there are, and what it is drawn with."""

    name: str
    count: int
    ink: Ink = PLAIN


def bars(title: str, rows: Sequence[BarRow], width: int) -> Group:
    """A bar for each row under a title, with its count and its share of all, so many characters wide."""
    total, most = (function([row.count for row in rows]) for function in (sum, max))
    names = max(len(row.name) for row in rows)
    table = Table.grid(padding=(0, 1, 0, 0))
    for justify in ("right", "left", "right", "right"):
        table.add_column(justify=justify, no_wrap=True)
    for row in rows:
        bar = Bar(max(1, most), 0, row.count, width=max(LEAST_WIDTH, width - names - FIGURES))
        bar.style += row.ink.style
        share = 100 * row.count / total if total else 0.0
        shown = "<1 %" if 0 < share < 1 else f"{share:.0f} %"
        table.add_row(Text(row.name), bar, Text(f"{row.count:,}"), Text(shown, "dim"))
    return Group(Text(title, "bold"), table)


def histogram(title: str, values: NDArray[np.floating | np.integer], width: int, most: int = 10) -> Group:
    """How many of the values, of which there is at least one, lie in each interval between round numbers."""
    low, high = float(values.min()), float(values.max())
    step = step_between(low, high, most)
    step = max(step, 1.0) if np.issubdtype(values.dtype, np.integer) else step
    begin = math.floor(low / step)
    counts = np.bincount(np.floor(values / step).astype(np.int64) - begin)
    edges = [f"{step * (begin + index):,.10g}" for index in range(len(counts) + 1)]
    return bars(title, [BarRow(f"{edges[i]} to {edges[i + 1]}", int(count)) for i, count in enumerate(counts)], width)
