"""How the groups of a report look: the same colour, line and mark for a group in every figure."""

import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from carrl.render.colours import BLACK, BLUE, GREEN, INK, ORANGE, PURPLE, SKY, VERMILLION
from carrl.report.curves import Curve
from carrl.report.groups import Group

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
LINES: tuple[tuple[float, tuple[float, ...]], ...] = ((0, ()), (0, (5, 2)), (0, (1.5, 1.5)), (0, (5, 2, 1.5, 2)))
MARKS = ("o", "s", "^", "D", "v", "P", "X")
MANY = 4
"""More bands than that are fainter, for they lie on one another."""
LABEL_CHARACTERS = 108
"""As many fit beside each other into a legend as wide as the figure."""


@dataclass(frozen=True)
class Look:
    """Of a group."""

    colour: str
    line: tuple[float, tuple[float, ...]]
    mark: str


def looks(groups: Sequence[Group]) -> dict[str, Look]:
    """By the groups' labels; lines differ where colours are used up, and with colours for those who see none."""
    return {
        group.label: Look(
            COLOURS[index % len(COLOURS)],
            LINES[(index // len(COLOURS) + index % len(COLOURS)) % len(LINES)],
            MARKS[index % len(MARKS)],
        )
        for index, group in enumerate(groups)
    }


def draw_curves(axes: Axes, curves: Sequence[Curve], styles: dict[str, Look], steps: bool = False) -> None:
    """Each curve as a line in its band; `steps` for shares, which jump."""
    alpha = 0.16 if len(curves) <= MANY else 0.08
    for curve in curves:
        look = styles[curve.label]
        if curve.runs > 1:
            axes.fill_between(
                curve.points,
                curve.band.low,
                curve.band.high,
                step="post" if steps else None,
                color=look.colour,
                alpha=alpha,
                linewidth=0,
            )
        axes.plot(
            curve.points,
            curve.band.value,
            color=look.colour,
            linestyle=look.line,
            linewidth=1.6,
            drawstyle="steps-post" if steps else "default",
        )


def name_groups(figure: Figure, curves: Sequence[Curve], styles: dict[str, Look]) -> None:
    """A legend above the panels."""
    handles = [
        Line2D(
            [],
            [],
            color=styles[curve.label].colour,
            linestyle=styles[curve.label].line,
            linewidth=1.6,
            label=_named(curve),
        )
        for curve in curves
    ]
    legend = figure.legend(
        handles=handles, loc="outside upper left", ncols=_columns(curves), frameon=False, fontsize=8, handlelength=2.6
    )
    for text in legend.get_texts():
        text.set(color=INK, parse_math=False)


def legend_rows(curves: Sequence[Curve]) -> int:
    """How many rows the legend takes."""
    return math.ceil(len(curves) / _columns(curves))


def _named(curve: Curve) -> str:
    return f"{short(curve.label, LABEL_CHARACTERS - 12)} ({curve.runs} run{'s' if curve.runs > 1 else ''})"


def _columns(curves: Sequence[Curve]) -> int:
    widest = max(len(_named(curve)) for curve in curves)
    return max(1, min(len(curves), LABEL_CHARACTERS // (widest + 5)))


def short(label: str, characters: int) -> str:
    """The label, its middle left out where it is longer."""
    if len(label) <= characters:
        return label
    half = (characters - 3) // 2
    return f"{label[:half]}...{label[-half:]}"


def wrapped(label: str, characters: int, lines: int = 3) -> str:
    """The label in a few lines, for the side of an axis."""
    label = re.sub(r",\s*", ", ", label)  # lists may break between their entries
    text = textwrap.wrap(label, characters, break_on_hyphens=False) or [label]
    return "\n".join(text if len(text) <= lines else [*text[: lines - 1], "..." + label[3 - characters :]])
