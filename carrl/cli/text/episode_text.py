"""One episode on the terminal: a line about it, a map of the drive, charts of its numbers, and a table of its steps.

Shapes: `T` steps, `R` rays, `A` actions.
"""

import math
from collections.abc import Iterator

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from carrl.log.laps import recorded_laps
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render import span
from carrl.render.colours import DARK, ERROR
from carrl.render.episode import EpisodeScene, Series, direction
from carrl.render.terminal import Chart, Ink, action_inks, map_chart, shows_colours, speed_inks
from carrl.render.trail import speed_span, steps_of

SIDE_BY_SIDE = 120
"""From so many characters to a line on, the charts stand beside the map."""
CHART_ROWS = 12
LEAST_MAP_ROWS, MOST_MAP_ROWS = 14, 2 * CHART_ROWS + 2
GAP = 3
"""Between map and charts, characters."""
MOST_LAPS = 3
"""Whose times are told."""
START, OTHER = Ink("S", DARK.car), Ink("o", DARK.other_car)
END_NAMES = {
    "collision": "collision",
    "time limit": "time limit",
    "other end": "other end",
    "laps complete": "laps complete",
    "unfinished": "the record ends",
}
MOST_ACTIONS, CHOSEN_AND_BEST = 6, ("chosen", "best")
"""Of more actions than that only the values of these two are in the table."""
FIRST, LAST = 5, 15
"""Of a longer episode, the table has so many of the first and of the last steps."""
WIDE = 100
"""From so many characters to a line on, the table has the probability of a random action, and more decimals."""
REASONS = "for"
"""The only column that may be folded."""
LONGEST = 100_000
"""Values of actions from here on are written with an exponent."""
LEVELS = "▁▂▃▄▅▆▇█"


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
    times = [f"{lap.seconds:.2f} s" + " with contact" * (not lap.counts) for lap in recorded_laps(trace)]
    shown = f" ({', '.join([*times[:MOST_LAPS], *['...'] * (len(times) > MOST_LAPS)])})" if times else ""
    return f"{gates:,} gate{'s' * (gates != 1)}" + f", {laps:,} lap{'s' * (laps != 1)}{shown}" * (laps > 0)


def _pictures(trace: EpisodeTrace, console: Console) -> RenderableType:
    """The map, and beside or below it the charts."""
    coloured = shows_colours(console)
    inks = action_inks(trace.scene.action_names, coloured)
    beside = console.width >= SIDE_BY_SIDE
    rows = min(max(console.height - 4, LEAST_MAP_ROWS), MOST_MAP_ROWS)
    width = (console.width - GAP) // 2 if beside else console.width
    drive = _map(trace, coloured, width, MOST_MAP_ROWS if beside else rows)
    charts: list[RenderableType] = [_return_chart(trace, width)]
    per_action = EpisodeScene(trace).per_action
    if per_action:
        charts += [Text(), _value_chart(trace, per_action, inks, width)]
    elif trace.speeds is not None:
        charts += [Text(), _speed_chart(trace, trace.speeds, width)]
    if not beside:
        return Group(drive, Text(), *charts)
    table = Table.grid(padding=(0, GAP, 0, 0))
    table.add_row(drive, Group(*charts))
    return table


def _map(trace: EpisodeTrace, coloured: bool, width: int, rows: int) -> Group:
    """The line driven, where the log tells it, in inks of the speed or of the actions, between the walls.

    Of the other cars of the world it has the places where they were at the end.
    """
    inks, legend = _trail_inks(trace, coloured)
    walls = Ink("braille", DARK.gate) if coloured else Ink("·")
    end = _end_ink(trace)
    chart = map_chart(trace.track, width, rows - 1, walls)
    x, y = trace.poses[:, 0], trace.poses[:, 1]
    known = np.append(False, np.diff(steps_of(trace)) == 1)
    chart.line(x, y, inks, joined=known)
    others = trace.others[-1]
    chart.line(others[:, 0], others[:, 1], OTHER, joined=False)
    chart.line(x[:1], y[:1], START).line(x[-1:], y[-1:], end)
    samples = [START.sample("start"), *legend, end.sample(END_NAMES[trace.ended])]
    samples += [OTHER.sample("another car at the end")] if len(others) else []
    parts = [chart.text(), Text("  ").join(samples)]
    off = int(np.count_nonzero(~trace.track.on_map(trace.poses[:, :2])))
    if off:
        parts.append(Text(f"{off:,} of {len(x):,} poses are off the map"))
    return Group(*parts)


def _trail_inks(trace: EpisodeTrace, coloured: bool) -> tuple[list[Ink], list[Text]]:
    """An ink for each pose, [T + 1], and what they mean."""
    if trace.speeds is not None:
        inks, (low, high) = speed_inks(coloured), speed_span(trace.speeds)
        shares = (trace.speeds - low) / (high - low)
        of_poses = [inks[min(int(share * len(inks)), len(inks) - 1)] for share in shares.tolist()]
        return of_poses, [inks[0].sample(f"{low:.1f} m/s"), inks[-1].sample(f"{high:.1f} m/s")]
    inks = action_inks(trace.scene.action_names, coloured)
    of_poses = [inks[action] for action in (*trace.actions, trace.actions[-1])]
    return of_poses, _legend(trace, inks) if trace.controls is None else []


def _speed_chart(trace: EpisodeTrace, speeds: Floats, width: int) -> Text:
    """The speed against the steps."""
    steps = steps_of(trace).astype(np.float64)
    chart = Chart(width, CHART_ROWS, "speed, m/s").axes(_span(steps), _span(speeds))
    return chart.line(steps, speeds, Ink("braille")).text()


def _legend(trace: EpisodeTrace, inks: list[Ink]) -> list[Text]:
    return [ink.sample(name) for ink, name in zip(inks, trace.scene.action_names, strict=True)]


def _end_ink(trace: EpisodeTrace) -> Ink:
    return Ink("X", ERROR) if trace.ended == "collision" else Ink("E", DARK.car)


def _return_chart(trace: EpisodeTrace, width: int) -> Text:
    """The sum of the rewards so far, against the steps."""
    returns = np.append(0.0, trace.rewards.cumsum())
    steps = steps_of(trace).astype(np.float64)
    chart = Chart(width, CHART_ROWS, "return so far").axes(_span(steps), _span(returns))
    return chart.line(steps, returns, Ink("braille")).text()


def _value_chart(trace: EpisodeTrace, per_action: Series, inks: list[Ink], width: int) -> Group:
    """The number of each action [A], in its ink, against the steps."""
    block = math.ceil(len(trace) / width)
    values = _block_means(per_action.values, block)
    steps = _block_means(steps_of(trace)[:-1, None].astype(np.float64), block)[:, 0]
    chart = Chart(width, CHART_ROWS, f"{per_action.title}{f', means of {block} steps' if block > 1 else ''}")
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


def step_table(trace: EpisodeTrace, rows: range | None, width: int) -> Table:
    """A row for each step.

    Args:
        trace: the episode.
        rows: which of the recorded steps, 0 .. T - 1; None for the first and the last ones.
        width: characters to a line.
    """
    wide, scene = width >= WIDE, EpisodeScene(trace)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 2 if wide else 1, 0, 0))
    for name, to_the_right in _columns(scene, wide):
        table.add_column(name, justify="right" if to_the_right else "left", no_wrap=name != REASONS)
    after = None
    for row in _shown(len(trace)) if rows is None else rows:
        if after is not None and row > after:
            table.add_row("⋮", style="dim")
        table.add_row(*_cells(scene, row, wide))
        after = row + 1
    return table


def _shown(steps: int) -> Iterator[int]:
    """The first and the last rows of an episode, all of one that is hardly longer."""
    return (row for row in range(steps) if row < FIRST or row >= steps - LAST or steps <= FIRST + LAST + 1)


def _columns(scene: EpisodeScene, wide: bool) -> list[tuple[str, bool]]:
    """Headings, and whether what is below stands at the right."""
    trace = scene.trace
    actions = [("action", False)]
    if trace.controls is not None:
        actions = [(name, True) for name in trace.scene.control_names]
    speed = [("m/s", True)] if trace.state("speed") is not None else []
    before = [("step", True), ("time s", True), ("nearest wall", False), ("rays", False), *speed, *actions]
    values = []
    if scene.per_action:
        word = scene.per_action.title.split()[-1]
        names = scene.per_action.entries if len(scene.per_action.entries) <= MOST_ACTIONS else CHOSEN_AND_BEST
        values = [(f"{word[0]} {name if wide else name[0]}", True) for name in names]
    numbers = [(name, True) for series in scene.told for name in series.entries] if wide else []
    return [*before, *values, ("reward", True), (REASONS, False), *numbers]


def _cells(scene: EpisodeScene, row: int, wide: bool) -> list[Text]:
    trace, per_action = scene.trace, scene.per_action
    step, action = int(trace.columns["step"][row]), int(trace.actions[row])
    star = "*" if trace.exploratory[row] else ""
    ink = action_inks(trace.scene.action_names, coloured=True)[action]
    values = []
    if per_action:
        decimals = _decimals(per_action.values) + wide
        of_actions, chosen = per_action.values[row], action
        if len(of_actions) > MOST_ACTIONS:
            of_actions, chosen = np.array([of_actions[action], of_actions.max()]), 0
        texts = [_value(value, decimals) for value in of_actions]
        values = [Text(text, "bold" if index == chosen else "") for index, text in enumerate(texts)]
    numbers = [Text(f"{value:.3f}") for series in scene.told for value in series.values[row]] if wide else []
    speeds = trace.state("speed")
    actions = [Text(trace.scene.action_names[action] + star, ink.style)]
    if trace.controls is not None:
        actions = [Text(f"{value:+.2f}") for value in trace.controls[row]]
        actions[-1].append(star)
    return [
        Text(f"{step:,}"),
        Text(f"{step * trace.scene.time_step:,.1f}"),
        Text(_nearest(trace, row)),
        Text(ray_bars(trace.ranges[row] / trace.scene.sensor_range)),
        *([] if speeds is None else [Text(f"{speeds[row]:.1f}")]),
        *actions,
        *values,
        Text(f"{trace.rewards[row]:+,.4g}" if trace.rewards[row] else "0"),
        Text(_reasons(trace, row, wide)),
        *numbers,
    ]


def ray_bars(readings: Floats) -> str:
    """A bar for each reading [R] in 0..1, from the driver's left to the right; a full one sees no wall."""
    levels = np.clip(readings[::-1] * len(LEVELS), 0, len(LEVELS) - 1).astype(np.int64)
    return "".join(LEVELS[level] for level in levels)


def _nearest(trace: EpisodeTrace, row: int) -> str:
    if not trace.ranges.shape[1]:
        return "-"
    ray = int(trace.ranges[row].argmin())
    if trace.ranges[row, ray] >= trace.scene.sensor_range:
        return "out of range"
    return f"{trace.ranges[row, ray]:.1f} m {direction(trace.scene.sensor_angles[ray])}"


def _reasons(trace: EpisodeTrace, row: int, wide: bool) -> str:
    """The terms of a reward that are not zero; where there is room and more than one, with their values."""
    terms = {
        name: value for name, value in zip(trace.scene.reward_terms, trace.reward_terms[row], strict=True) if value
    }
    with_values = wide and len(terms) > 1
    return ", ".join(f"{name} {value:+,.4g}" if with_values else name for name, value in terms.items())


def _value(value: float, decimals: int) -> str:
    return f"{value:,.{decimals}f}" if abs(value) < LONGEST else f"{value:.1e}"


def _decimals(values: Floats) -> int:
    """As many as leave three figures to the greatest of the values that are not too long to be written out."""
    greatest = float(np.abs(values).max(initial=0, where=np.abs(values) < LONGEST))
    return int(np.clip(2 - math.floor(math.log10(greatest)), 0, 3)) if greatest > 0 else 0
