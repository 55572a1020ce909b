"""Counts as bars of characters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.bar import Bar
from rich.console import Group
from rich.table import Table
from rich.text import Text

from carrl.render.terminal_chart import Ink, step_between

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
