"""Where tables and charts are printed. Imported where it is needed, for rich takes a while to load."""

import os
from collections.abc import Collection, Sequence
from typing import NoReturn

from rich.console import Console
from rich.table import Table
from rich.text import Text

from carrl.errors import printable

PIPE_WIDTH = 160
"""Width of what does not go to a terminal, unless the variable COLUMNS tells one, characters."""
UNLIMITED = 10_000
"""Width of a table that does not go to a terminal, so that nothing in it is folded, characters."""


class TextConsole(Console):
    """A console that prints text as it is, for "[3]" is a shape here, and no style."""

    def __init__(self, to_stderr: bool = False) -> None:
        super().__init__(markup=False, highlight=False, emoji=False, stderr=to_stderr)
        if not self.is_terminal and "COLUMNS" not in os.environ:
            self.width = PIPE_WIDTH

    def on_broken_pipe(self) -> NoReturn:
        """Leaves it to the command to end well when the reader has gone; rich would end the process with code 1."""
        raise


def print_table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    figures: Collection[str] | None = None,
    to_stderr: bool = False,
) -> None:
    """Prints a table under its title; its text may be anything that a file holds.

    Args:
        title: above the table.
        header: of the columns; all empty for none.
        rows: what stands in the columns.
        figures: of the columns that have numbers, which end at their right; None for all but the first one.
        to_stderr: whether it is no part of what was asked for, but what went wrong.
    """
    console = TextConsole(to_stderr)
    if not console.is_terminal:
        console.width = UNLIMITED
    table = Table(show_header=any(header))
    for name in header:
        is_figure = name in (header[1:] if figures is None else figures)
        table.add_column(name, overflow="fold", justify="right" if is_figure else "left")
    for row in rows:
        table.add_row(*map(printable, row))
    console.print(Text(printable(title), style="bold"))
    console.print(table)
