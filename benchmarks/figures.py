"""What was measured, and the tables that show it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

HEADER = ("contestant", "frames/s", "min..max", "times SB3", "by round", "frames", "updates", "seconds")


@dataclass(frozen=True)
class Measurement:
    """One contestant in one round.

    Attributes:
        frames: env steps made, of all cars and seeds together.
        updates: gradient steps made, of all seeds together.
        seconds: wall time they took.
    """

    frames: int
    updates: int
    seconds: float

    @property
    def frames_per_s(self) -> float:
        """Env steps for each second of wall time."""
        return self.frames / self.seconds


Rounds = Mapping[str, Sequence[Measurement]]
"""The measurements of every contestant, by title, in the order of the rounds."""


def fastest(rounds: Rounds, titles: Sequence[str]) -> str | None:
    """Which of these contestants has the highest median speed; None where none of them was measured."""
    measured = [title for title in titles if title in rounds]
    return max(measured, key=lambda title: _median_speed(rounds[title])) if measured else None


def ratios(own: Sequence[float], reference: Sequence[float]) -> list[float]:
    """How many times as fast as the reference, round by round."""
    return [mine / theirs for mine, theirs in zip(own, reference, strict=True)]


def speed_row(title: str, rounds: Rounds, reference: str | None) -> list[str]:
    """A contestant's figures under `HEADER`; frames, updates and seconds are those of the median round."""
    own = rounds[title]
    speeds = [each.frames_per_s for each in own]
    middle = sorted(own, key=lambda each: each.frames_per_s)[len(own) // 2]
    against = ["-", "-"]
    if reference is not None:
        by_round = ratios(speeds, [each.frames_per_s for each in rounds[reference]])
        against = [
            f"{_median_speed(own) / _median_speed(rounds[reference]):.2f}",
            f"{min(by_round):.2f}..{max(by_round):.2f}",
        ]
    return [
        title,
        f"{median(speeds):,.0f}",
        f"{min(speeds):,.0f}..{max(speeds):,.0f}",
        *against,
        f"{middle.frames:,}",
        f"{middle.updates:,}",
        f"{middle.seconds:.1f}",
    ]


def spread(values: Sequence[float], digits: int = 1) -> str:
    """Median and min..max, as in 3.1 (2.9..3.4); a dash where there are none."""
    if not values:
        return "-"
    return f"{median(values):.{digits}f} ({min(values):.{digits}f}..{max(values):.{digits}f})"


def plain_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = [header, ["-" * width for width in widths], *rows]
    return "\n".join(
        "  ".join(
            [line[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))]
        ).rstrip()
        for line in lines
    )


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The same for a page."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _median_speed(measurements: Sequence[Measurement]) -> float:
    return median(each.frames_per_s for each in measurements)
