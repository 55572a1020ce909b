"""One episode on the terminal: a line about it, a map of the drive, its rewards and Q-values, and a table of its steps.

Shapes: `T` steps, `A` actions.
"""

import math

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from carrl.cli.text.episode_table import step_table
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import steps_of
from carrl.render.terminal_chart import Chart, Ink, action_inks, map_chart, shows_colours, span
from carrl.render.viewer_palette import CAR, ERROR, GATE

SIDE_BY_SIDE = 120
"""From so many characters to a line on, the charts stand beside the map."""
CHART_ROWS = 12
LEAST_MAP_ROWS, MOST_MAP_ROWS = 14, 2 * CHART_ROWS + 2
GAP = 3
"""Between map and charts, characters."""
START = Ink("S", CAR)
END_NAMES = {"collision": "collision", "time limit": "time limit", "unfinished": "the record ends"}


def print_episode(trace: EpisodeTrace, console: Console, rows: range | None = None) -> None:
    """Prints an episode as wide as the console.

    Args:
        trace: the episode.
        console: where to; without colours, actions are told apart by letters.
        rows: which of the recorded steps, 0 .. T - 1, the table has; None for the first and the last ones.
    """
    console.print(_summary(trace), highlight=False)
    console.print()
    console.print(_pictures(trace, console))
    console.print()
    console.print(step_table(trace, rows, console.width), highlight=False)
    if trace.exploratory.any():
        console.print("* drawn at random", style="dim", highlight=False)


def _summary(trace: EpisodeTrace) -> Text:
    seconds = len(trace) * trace.scene.time_step
    late = f", recorded from step {trace.first_step:,}" if trace.first_step else ""
    parts = [
        Text(f"episode {trace.episode:,}", "bold"),
        Text(f"car {trace.car} on {trace.track.name}"),
        Text(f"{len(trace):,} steps in {seconds:,.1f} s{late}"),
        Text(f"return {trace.rewards.sum():,.4g}"),
        Text(_progress(trace)),
        Text(END_NAMES[trace.ended], _end_ink(trace).style),
    ]
    return Text(" · ").join(parts)


def _progress(trace: EpisodeTrace) -> str:
    gates = int(trace.gates_passed[-1])
    laps = gates // len(trace.track.gates)
    return f"{gates:,} gate{'s' * (gates != 1)}" + f", {laps:,} lap{'s' * (laps != 1)}" * (laps > 0)


def _pictures(trace: EpisodeTrace, console: Console) -> RenderableType:
    """The map, and beside or below it the charts."""
    inks = action_inks(trace.scene.action_names, shows_colours(console))
    beside = console.width >= SIDE_BY_SIDE
    rows = min(max(console.height - 4, LEAST_MAP_ROWS), MOST_MAP_ROWS)
    width = (console.width - GAP) // 2 if beside else console.width
    drive = _map(trace, inks, width, MOST_MAP_ROWS if beside else rows)
    charts = _return_chart(trace, width), _value_chart(trace, inks, width)
    if not beside:
        return Group(drive, Text(), charts[0], Text(), charts[1])
    table = Table.grid(padding=(0, GAP, 0, 0))
    table.add_row(drive, Group(charts[0], Text(), charts[1]))
    return table


def _map(trace: EpisodeTrace, inks: list[Ink], width: int, rows: int) -> Group:
    """The line driven, where the log tells it, in the inks of the actions [A], between the walls."""
    coloured = inks[0].symbol == "braille"
    walls = Ink("braille", GATE) if coloured else Ink("·")
    end = _end_ink(trace)
    chart = map_chart(trace.track, width, rows - 1, walls)
    x, y = trace.poses[:, 0], trace.poses[:, 1]
    known = np.append(False, np.diff(steps_of(trace)) == 1)
    chart.line(x, y, [inks[action] for action in (*trace.actions, trace.actions[-1])], joined=known)
    chart.line(x[:1], y[:1], START).line(x[-1:], y[-1:], end)
    samples = [START.sample("start"), *_legend(trace, inks), end.sample(END_NAMES[trace.ended])]
    parts = [chart.text(), Text("  ").join(samples)]
    off = int(np.count_nonzero(~trace.track.on_map(trace.poses[:, :2])))
    if off:
        parts.append(Text(f"{off:,} of {len(x):,} poses are off the map"))
    return Group(*parts)


def _legend(trace: EpisodeTrace, inks: list[Ink]) -> list[Text]:
    return [ink.sample(name) for ink, name in zip(inks, trace.scene.action_names, strict=True)]


def _end_ink(trace: EpisodeTrace) -> Ink:
    return Ink("X", ERROR) if trace.ended == "collision" else Ink("E", CAR)


def _return_chart(trace: EpisodeTrace, width: int) -> Text:
    """The sum of the rewards so far, against the steps."""
    returns = np.append(0.0, trace.rewards.cumsum())
    steps = steps_of(trace).astype(np.float64)
    chart = Chart(width, CHART_ROWS, "return so far").axes(_span(steps), _span(returns))
    return chart.line(steps, returns, Ink("braille")).text()


def _value_chart(trace: EpisodeTrace, inks: list[Ink], width: int) -> Group:
    """The Q-value of each action [A], in its ink, against the steps."""
    block = math.ceil(len(trace) / width)
    values = _block_means(trace.action_values, block)
    steps = _block_means(steps_of(trace)[:-1, None].astype(np.float64), block)[:, 0]
    chart = Chart(width, CHART_ROWS, f"Q-values{f', means of {block} steps' if block > 1 else ''}")
    chart.axes(_span(steps), _span(values))
    for action, ink in enumerate(inks):
        chart.line(steps, values[:, action], ink)
    return Group(chart.text(), Text("  ").join(_legend(trace, inks)))


def _block_means(values: Floats, block: int) -> Floats:
    """Means of each so many rows, [T, A] to [ceil(T / block), A]."""
    starts = np.arange(0, len(values), block)
    counts = np.diff(np.append(starts, len(values)))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / counts[:, None])


def _span(values: Floats) -> tuple[float, float]:
    """From the least to the greatest finite value; a little more where they are the same."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    return span(low, high)
