"""The statistics of a log on the terminal: how its episodes went, what was chosen, and where cars crashed.

Shapes: `A` actions, `K` places.
"""

from itertools import pairwise

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from carrl.log.scene import TrackShape
from carrl.render import round_number, span
from carrl.render.colours import DARK, ERROR, WARNING
from carrl.render.terminal import BarRow, Chart, Ink, action_inks, bars, histogram, map_chart, shows_colours
from carrl.report.log_stats import CONTROL_EDGES, NO_EPISODE, LogStats, crowding, distinct, section_name

SIDE_BY_SIDE = 120
"""From so many characters to a line on, two parts stand beside each other."""
GAP = 3
"""Between the two, characters."""
CHART_ROWS, MAP_ROWS = 12, 20
MOST_SECTIONS = 16
"""Of the track, with the most crashes, that have a bar each."""
DENSITIES = 0.15, 0.5
"""From which share of the densest place on there are some crashes, and many."""
AMOUNTS = "few", "some", "many"
MOST_GATE_NUMBERS = 12
START = Ink("S", DARK.ray)
ENDS = {"collision": "collision", "time limit": "the time limit", "other end": "another end"}
MOST_BLOCKS = 60
"""Points of the curve of returns."""


def print_log_stats(stats: LogStats, console: Console) -> None:
    """Prints the statistics as wide as the console."""
    beside = console.width >= SIDE_BY_SIDE
    width = (console.width - GAP) // 2 if beside else console.width
    coloured = shows_colours(console)
    console.print(_headline(stats), highlight=False)
    for pair in _pairs(stats, width, coloured):
        console.print()
        console.print(_beside(pair) if beside else Group(pair[0], Text(), pair[1]), highlight=False)


def _headline(stats: LogStats) -> Text:
    steps = f"{stats.action_counts.sum():,} transitions"
    if not np.isnan(stats.exploratory_share):
        steps += f", {100 * stats.exploratory_share:.0f} % of them drawn at random"
    if not len(stats):
        return Text(f"{steps}\n{NO_EPISODE}")
    laps, share = int((stats.laps > 0).sum()), 100 / len(stats)
    ends = (f"{count:,} by {ENDS[name]} ({share * count:.0f} %)" for name, count in stats.ends_counted.items())
    return Text("\n").join(
        [
            Text(f"{len(stats):,} episodes ended: {', '.join(ends)}"),
            Text(f"{stats.laps.sum():,} laps, in {laps:,} episode{'s' * (laps != 1)} ({share * laps:.0f} %)"),
            Text(steps),
        ]
    )


def _pairs(stats: LogStats, width: int, coloured: bool) -> list[tuple[RenderableType, RenderableType]]:
    """The parts, two and two."""
    actions = _actions(stats, width)
    if not len(stats):
        return [(actions, Text())]
    pairs: list[tuple[RenderableType, RenderableType]] = [
        (_return_curve(stats, width), actions),
        (histogram("return of an episode", stats.returns, width), histogram("its steps", stats.lengths, width)),
    ]
    if len(stats.crash_places):
        pairs.append((_crash_map(stats, width, coloured), _sections(stats, width)))
    return pairs


def _beside(pair: tuple[RenderableType, RenderableType]) -> Table:
    table = Table.grid(padding=(0, GAP, 0, 0))
    table.add_row(*pair)
    return table


def _actions(stats: LogStats, width: int) -> Group:
    """How often each action was chosen, or where actions are numbers, how often each control lay where."""
    if stats.control_counts is not None:
        between = [f"{low:+.2f} to {high:+.2f}" for low, high in pairwise(CONTROL_EDGES)]
        charts = [
            bars(name, [BarRow(*row) for row in zip(between, counts, strict=True)], width)
            for name, counts in zip(stats.scene.control_names, stats.control_counts.tolist(), strict=True)
        ]
        return Group(*[part for chart in charts for part in (chart, Text())][:-1])
    names = stats.scene.action_names
    inks = action_inks(names, coloured=True)
    counts = stats.action_counts.tolist()
    return bars("actions", [BarRow(*row) for row in zip(names, counts, inks, strict=True)], width)


def _return_curve(stats: LogStats, width: int) -> Text:
    """Means of the returns of so many episodes each, against the number of episodes ended."""
    blocks = np.array_split(stats.returns, min(MOST_BLOCKS, len(stats)))
    means = np.array([block.mean() for block in blocks])
    ends = np.cumsum([len(block) for block in blocks])
    each = len(blocks[0])
    chart = Chart(width, CHART_ROWS, f"return{f', mean of {each:,} episodes' if each > 1 else ''}")
    chart.axes((0, len(stats)), span(float(means.min()), float(means.max())))
    return chart.line(ends - (each - 1) / 2, means, Ink("braille")).text()


def _crash_map(stats: LogStats, width: int, coloured: bool) -> Group:
    """Where cars crashed, in an ink for each of three densities."""
    chart = map_chart(stats.track, width, MAP_ROWS, Ink("braille", DARK.gate) if coloured else Ink("·"))
    colours = DARK.car, WARNING, ERROR
    inks = [Ink("braille", colour) for colour in colours] if coloured else [Ink(letter) for letter in "xX#"]
    places = stats.crash_places
    left, bottom, right, top = stats.track.bounds
    resolution = max(right - left, top - bottom) / 200
    crowds = crowding(places, 4 * resolution)
    levels = np.digitize(crowds / crowds.max(), DENSITIES)
    for level, ink in enumerate(inks):
        shown = places[levels == level]
        shown = shown[distinct(shown, resolution)]
        chart.line(shown[:, 0], shown[:, 1], ink, joined=False)
    _number_gates(chart, stats.track)
    samples = [START.sample("start"), *(ink.sample(name) for ink, name in zip(inks, AMOUNTS, strict=True))]
    legend = Text("  ").join(samples)
    parts = [Text(f"where cars crashed on {stats.track_note}", "bold"), chart.text(), legend]
    if stats.off_the_map:
        parts.append(Text(f"{stats.off_the_map:,} crashed off the map"))
    return Group(*parts)


def _number_gates(chart: Chart, track: TrackShape) -> None:
    """Numbers in the middle of the gates, or of some of them; the last one is the start line."""
    middles = track.gates.mean(axis=1)
    every = round(round_number(max(1.0, len(middles) / MOST_GATE_NUMBERS)))
    for gate in range(every - 1, len(middles) - 1, every):
        chart.line(middles[gate, :1], middles[gate, 1:], Ink(str(gate + 1)))
    chart.line(middles[-1, :1], middles[-1, 1:], START)


def _sections(stats: LogStats, width: int) -> Group:
    """The sections with the most crashes, in driving order."""
    counts = stats.crashes_by_section
    worst = np.sort(np.argsort(-counts, kind="stable")[:MOST_SECTIONS])
    shown = worst[counts[worst] > 0]
    ink = Ink("braille", ERROR)
    rows = [BarRow(section_name(section, len(counts)), int(counts[section]), ink) for section in shown.tolist()]
    rest = counts.sum() - counts[shown].sum()
    if rest:
        rows.append(BarRow("elsewhere", int(rest), ink))
    return bars("between which gates", rows, width)
