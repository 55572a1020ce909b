"""The tables of `scripts/bench sim`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

from benchmarks.figures import ratios

Speeds = Mapping[int, Sequence[float]]
"""Car-steps a second by how many cars there were, one for each round."""


@dataclass(frozen=True)
class Row:
    """One contestant on one track.

    Attributes:
        contestant: its name.
        track: its name.
        title: for the tables.
        speeds: what was measured.
    """

    contestant: str
    track: str
    title: str
    speeds: dict[int, list[float]] = field(default_factory=dict)

    @property
    def best_cars(self) -> int:
        """The number of cars with the highest median speed."""
        return max(self.speeds, key=lambda cars: median(self.speeds[cars]))

    @property
    def best(self) -> Sequence[float]:
        """The speeds with so many cars, one for each round."""
        return self.speeds[self.best_cars]


@dataclass(frozen=True)
class Reference:
    """Something that rows are compared with.

    Attributes:
        heading: of its column.
        speeds: its own at its best, one for each round, by the title of the row that is compared with it.
    """

    heading: str
    speeds: Mapping[str, Sequence[float]]


def sizes_table(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the median speeds, a column for each number of cars."""
    sizes = sorted({cars for row in rows for cars in row.speeds})
    cells = [[_speed(row.speeds[cars]) if cars in row.speeds else "-" for cars in sizes] for row in rows]
    header = ["car-steps/s with", *("1 car" if cars == 1 else f"{cars:,}" for cars in sizes)]
    return header, [[row.title, *line] for row, line in zip(rows, cells, strict=True)]


def best_table(rows: Sequence[Row], references: Sequence[Reference]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of every row at its best number of cars, against the references."""
    header = ["at its best", "cars", "car-steps/s", "min..max", *(each.heading for each in references)]
    lines = [
        [
            row.title,
            f"{row.best_cars:,}",
            _speed(row.best),
            f"{min(row.best):,.0f}..{max(row.best):,.0f}",
            *(_times(row.best, each.speeds.get(row.title)) for each in references),
        ]
        for row in rows
    ]
    return header, lines


def against_all(heading: str, rows: Sequence[Row], speeds: Sequence[float]) -> Reference:
    """The same reference for every row."""
    return Reference(heading, {row.title: speeds for row in rows})


def against_first_track(heading: str, rows: Sequence[Row], first: str) -> Reference:
    """Every row on another track against that of the same contestant on the first one."""
    on_first = {row.contestant: row.best for row in rows if row.track == first}
    others = [row for row in rows if row.track != first and row.contestant in on_first]
    return Reference(heading, {row.title: on_first[row.contestant] for row in others})


def _speed(speeds: Sequence[float]) -> str:
    return f"{median(speeds):,.0f}"


def _times(own: Sequence[float], reference: Sequence[float] | None) -> str:
    """Ratio of the medians, and min..max of the rounds' ratios, as in 3.10 (2.90..3.40)."""
    if reference is None:
        return "-"
    by_round = ratios(own, reference)
    return f"{_digits(median(own) / median(reference))} ({_digits(min(by_round))}..{_digits(max(by_round))})"


def _digits(ratio: float) -> str:
    """About three digits that count."""
    if ratio >= 100:
        return f"{ratio:,.0f}"
    return f"{ratio:.1f}" if ratio >= 10 else f"{ratio:.2f}" if ratio >= 0.1 else f"{ratio:.2g}"
