"""Where tables and charts are printed. Imported where it is needed, for rich takes a while to load."""

import os
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple, NoReturn

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from carrl.errors import printable

PIPE_WIDTH = 160
"""Width of what does not go to a terminal, unless the variable COLUMNS tells one, characters."""
UNLIMITED = 10_000
"""Width of a table that does not go to a terminal, unless COLUMNS tells one: nothing in it is folded, characters."""
MOST_WIDE = 120
"""Width of the widest table on a terminal, characters."""
LEAST_TEXT = 24
"""To so few characters a column of text may be folded."""
FRAME = 3
"""What each column has beside its text, characters."""


class TextConsole(Console):
    """A console that prints text as it is, for "[3]" is a shape here, and no style."""

    def __init__(self, to_stderr: bool = False) -> None:
        super().__init__(markup=False, highlight=False, emoji=False, stderr=to_stderr)
        if not self.is_terminal and "COLUMNS" not in os.environ:
            self.width = PIPE_WIDTH

    def on_broken_pipe(self) -> NoReturn:
        """Leaves it to the command to end well when the reader has gone; rich would end the process with code 1."""
        raise


class _Column(NamedTuple):
    """A column of a table.

    Attributes:
        name: its heading.
        cells: what stands below.
        is_figure: whether they are numbers, which end at their right and are never folded.
    """

    name: str
    cells: list[str]
    is_figure: bool

    @property
    def most(self) -> int:
        """Characters that it takes when nothing is folded."""
        return max(map(cell_len, (self.name, *self.cells)))

    @property
    def least(self) -> int:
        """Characters that it needs: for the longest word of its heading, and its figures."""
        words = (*self.name.split(), *(self.cells if self.is_figure else ()))
        least = max(map(cell_len, words), default=0)
        return least if self.is_figure else max(least, min(self.most, LEAST_TEXT))


def print_table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    figures: Collection[str] | None = None,
    to_stderr: bool = False,
) -> None:
    """Prints a table under its title; its text may be anything that a file holds.

    On a terminal text is folded, and columns that still have no room follow below, beside the first one again.

    Args:
        title: above the table.
        header: of the columns; all empty for none.
        rows: what stands in the columns.
        figures: of the columns that have numbers, which end at their right; None for all but the first one.
        to_stderr: whether it is no part of what was asked for, but what went wrong.
    """
    console = TextConsole(to_stderr)
    is_limited = console.is_terminal or "COLUMNS" in os.environ
    console.width = min(console.width, MOST_WIDE) if is_limited else UNLIMITED
    texts = [[printable(row[index]) for row in rows] for index in range(len(header))]
    columns = [
        _Column(name, cells, name in (header[1:] if figures is None else figures))
        for name, cells in zip(header, texts, strict=True)
    ]
    console.print(Text(printable(title), style="bold"), soft_wrap=True)  # a path in it can be copied
    for part in _parts(columns, console.width - 1):
        table = Table(show_header=any(header))
        for column, width in zip(part, _widths(part, console.width - 1), strict=True):
            table.add_column(column.name, overflow="fold", justify="right" if column.is_figure else "left", width=width)
        for row in zip(*(column.cells for column in part), strict=True):
            table.add_row(*row)
        console.print(table)


def _parts(columns: Sequence[_Column], room: int) -> Iterator[list[_Column]]:
    """The columns of each table, as many as have room; the first one is in all of them."""
    part = [columns[0]]
    for column in columns[1:]:
        if len(part) > 1 and sum(each.least + FRAME for each in (*part, column)) > room:
            yield part
            part = [columns[0]]
        part.append(column)
    yield part


def _widths(columns: Sequence[_Column], room: int) -> list[int]:
    """What each column needs, and a fair share of what is left until it has all it wants."""
    widths = [column.least for column in columns]
    spare = max(room - sum(widths) - FRAME * len(widths), 0)
    wishes = sorted((column.most - column.least, index) for index, column in enumerate(columns))
    for place, (wish, index) in enumerate(wishes):
        share = min(wish, spare // (len(wishes) - place))
        widths[index] += share
        spare -= share
    return widths
