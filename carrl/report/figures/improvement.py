"""Probabilities of improvement: a panel for each pair of groups, a row for each measure."""

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from carrl.render.colours import FAINT, INK, VERMILLION
from carrl.render.figure import new_figure, plain_axes, save_figure
from carrl.report.comparison import Comparison
from carrl.report.figures.series import wrapped
from carrl.report.findings import Findings
from carrl.report.measures import MEASURES, Measure
from carrl.report.statistics import Estimate

MOST_COLUMNS = 3
TITLE_CHARACTERS = 84
"""As many fit beside each other into the figure's width."""
UNDECIDED = "#7a7a7a"


def draw_improvement(path: Path, findings: Findings) -> bool:
    """Writes a PNG of every pair that was compared; False, and no file, where none was."""
    if not findings.comparisons:
        return False
    order = {group.label: index for index, group in enumerate(findings.groups)}
    pairs = list(dict.fromkeys(_pair(comparison, order) for comparison in findings.comparisons))
    measures = [each for each in MEASURES if any(comparison.measure is each for comparison in findings.comparisons)]
    columns = min(MOST_COLUMNS, len(pairs))
    rows = math.ceil(len(pairs) / columns)
    titles = [_title(pair, TITLE_CHARACTERS // columns) for pair in pairs]
    title_height = 0.14 * max(title.count("\n") for title in titles)
    figure = new_figure(height=0.7 + rows * (0.45 + title_height + 0.21 * len(measures)))
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat)
    for axes, pair, title in zip(panels, pairs, titles, strict=False):
        shown = [comparison for comparison in findings.comparisons if _pair(comparison, order) == pair]
        _draw_panel(axes, shown, pair, measures)
        axes.set_title(title, fontsize=8, color=INK, loc="left", parse_math=False)
    for axes in panels[len(pairs) :]:
        axes.set_visible(False)
    figure.supxlabel("probability that the group above is better than the other", color=INK, fontsize=8.5)
    figure.legend(handles=_legend(), loc="outside upper left", ncols=2, frameon=False, fontsize=8)
    save_figure(figure, path)
    return True


def _pair(comparison: Comparison, order: dict[str, int]) -> tuple[str, str]:
    """The later group and the earlier one."""
    later, earlier = sorted((comparison.first, comparison.second), key=order.__getitem__, reverse=True)
    return later, earlier


def _title(pair: tuple[str, str], characters: int) -> str:
    return f"{wrapped(pair[0], characters)}\nagainst {wrapped(pair[1], characters - 8)}"


def _draw_panel(axes: Axes, shown: Sequence[Comparison], pair: tuple[str, str], measures: Sequence[Measure]) -> None:
    plain_axes(axes)
    axes.axvline(0.5, color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)))
    for comparison in shown:
        row, chance = measures.index(comparison.measure), _of(pair[0], comparison)
        colour = VERMILLION if comparison.significant else UNDECIDED
        axes.plot([chance.low, chance.high], [row, row], color=colour, linewidth=2.2, solid_capstyle="butt")
        face = colour if comparison.significant else "white"
        axes.plot(chance.value, row, "o", color=colour, markerfacecolor=face, markersize=5.5, clip_on=False, zorder=3)
    axes.set_yticks(range(len(measures)), [measure.name for measure in measures])
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.set_ylim(len(measures) - 0.4, -0.6)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "1"])
    axes.tick_params(labelbottom=True)


def _of(group: str, comparison: Comparison) -> Estimate:
    """The probability that this group is the better one."""
    return comparison.probability if comparison.first == group else comparison.probability.complement


def _legend() -> list[Line2D]:
    return [
        Line2D(
            [], [], color=VERMILLION, marker="o", linewidth=2.2, markersize=5.5, label="significant, with 95 % interval"
        ),
        Line2D(
            [],
            [],
            color=UNDECIDED,
            marker="o",
            markerfacecolor="white",
            linewidth=2.2,
            markersize=5.5,
            label="not significant",
        ),
    ]
