"""What tuning shows on the terminal: a line for each trial, and a table of the best at the end."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape

from carrl.cli.text.terminal_table import print_table
from carrl.printable import printable

MOST_ROWS = 20


class TrialRow(NamedTuple):
    """A trial that has ended.

    Attributes:
        number: from 0.
        end: "complete", "given up" or "failed".
        value: of one that is complete.
        settings: what it drew.
        seconds: that it took.
        error: what ended it, if it failed.
    """

    number: int
    end: str
    value: float | None
    settings: Mapping[str, str]
    seconds: float
    error: str | None


class TuningConsole:
    """Tells how tuning goes.

    Args:
        trials: how many there will be.
        keys: what they draw.
        maximizes: whether greater values are better.
    """

    def __init__(self, trials: int, keys: Sequence[str], maximizes: bool) -> None:
        self._trials, self._keys, self._maximizes = trials, keys, maximizes
        self._console = Console(stderr=True, soft_wrap=True, highlight=False)

    def show_rest(self, rows: Sequence[TrialRow]) -> None:
        """Prints what is still to come, once the first trials tell."""
        if rows:
            seconds = sum(row.seconds for row in rows) / len(rows) * (self._trials - len(rows))
            self._console.print(f"      about {seconds / 60:.1f} min left")

    def show(self, rows: Sequence[TrialRow]) -> None:
        """Prints the latest trial."""
        row = rows[-1]
        settings = " ".join(f"{key}={_short(value)}" for key, value in row.settings.items())
        told = row.error or ("given up, as it does worse than half of the others" if row.value is None else _value(row))
        self._console.print(
            escape(printable(f"[{len(rows)}/{self._trials}] {settings}: {told} after {row.seconds:.1f} s"))
        )

    def print_results(self, rows: Sequence[TrialRow]) -> None:
        """Prints the trials, the best first, and how many were given up."""
        if not rows:
            return
        ordered = sorted(rows, key=self._rank)
        cells = [
            (str(row.number), row.end, _value(row), *(_short(row.settings.get(key, "")) for key in self._keys))
            for row in ordered[:MOST_ROWS]
        ]
        given_up = sum(row.end == "given up" for row in rows)
        print_table(f"{len(rows)} trials, {given_up} given up early", ("trial", "end", "value", *self._keys), cells)

    def _rank(self, row: TrialRow) -> float:
        if row.value is None:
            return math.inf
        return -row.value if self._maximizes else row.value


def _value(row: TrialRow) -> str:
    return "" if row.value is None else f"{row.value:,.5g}" if abs(row.value) < 100 else f"{row.value:,.0f}"


def _short(value: str) -> str:
    """A number with four digits; other values as they are."""
    try:
        return f"{float(value):.4g}" if "." in value or "e" in value else value
    except ValueError:
        return value
