"""The steps of an episode as a table on the terminal.

Shapes: `T` steps, `R` rays, `A` actions.
"""

import math
from collections.abc import Iterator

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_events import direction
from carrl.render.terminal_chart import action_inks

FIRST, LAST = 5, 15
"""Of a longer episode, the table has so many of the first and of the last steps."""
WIDE = 100
"""From so many characters to a line on, the table has the probability of a random action, and more decimals."""
REASONS = "for"
"""The only column that may be folded."""
LONGEST = 100_000
"""Q-values from here on are written with an exponent."""
LEVELS = "▁▂▃▄▅▆▇█"


def step_table(trace: EpisodeTrace, rows: range | None, width: int) -> Table:
    """A row for each step.

    Args:
        trace: the episode.
        rows: which of the recorded steps, 0 .. T - 1; None for the first and the last ones.
        width: characters to a line.
    """
    wide = width >= WIDE
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 2 if wide else 1, 0, 0))
    for name, to_the_right in _columns(trace, wide):
        table.add_column(name, justify="right" if to_the_right else "left", no_wrap=name != REASONS)
    after = None
    for row in _shown(len(trace)) if rows is None else rows:
        if after is not None and row > after:
            table.add_row("⋮", style="dim")
        table.add_row(*_cells(trace, row, wide))
        after = row + 1
    return table


def _shown(steps: int) -> Iterator[int]:
    """The first and the last rows of an episode, all of one that is hardly longer."""
    return (row for row in range(steps) if row < FIRST or row >= steps - LAST or steps <= FIRST + LAST + 1)


def _columns(trace: EpisodeTrace, wide: bool) -> list[tuple[str, bool]]:
    """Headings, and whether what is below stands at the right."""
    before = [("step", True), ("time s", True), ("nearest wall", False), ("rays", False), ("action", False)]
    values = [(f"Q {name}" if wide else f"Q {name[0]}", True) for name in trace.scene.action_names]
    after = [("reward", True), (REASONS, False)]
    return [*before, *values, *after, *([("epsilon", True)] if wide else [])]


def _cells(trace: EpisodeTrace, row: int, wide: bool) -> list[Text]:
    step, action = int(trace.columns["step"][row]), int(trace.actions[row])
    decimals = _decimals(trace.action_values) + wide
    star = "*" if trace.exploratory[row] else ""
    ink = action_inks(trace.scene.action_names, coloured=True)[action]
    values = [
        Text(_value(value, decimals), "bold" if index == action else "")
        for index, value in enumerate(trace.action_values[row])
    ]
    return [
        Text(f"{step:,}"),
        Text(f"{step * trace.scene.time_step:,.1f}"),
        Text(_nearest(trace, row)),
        Text(ray_bars(trace.ranges[row] / trace.scene.sensor_range)),
        Text(trace.scene.action_names[action] + star, ink.style),
        *values,
        Text(f"{trace.rewards[row]:+,.4g}" if trace.rewards[row] else "0"),
        Text(_reasons(trace, row, wide)),
        *([Text(f"{trace.epsilon[row]:.3f}")] if wide else []),
    ]


def ray_bars(readings: Floats) -> str:
    """A bar for each reading [R] in 0..1, from the driver's left to the right; a full one sees no wall."""
    levels = np.clip(readings[::-1] * len(LEVELS), 0, len(LEVELS) - 1).astype(np.int64)
    return "".join(LEVELS[level] for level in levels)


def _nearest(trace: EpisodeTrace, row: int) -> str:
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
