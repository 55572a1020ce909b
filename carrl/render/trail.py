"""The line driven: where the log tells it, and its colours.

Shapes: `T` steps, `N` steps whose way is known.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.colours import SHADES, Theme


def steps_of(trace: EpisodeTrace) -> NDArray[np.int64]:
    """Index within the episode of each recorded step, and the one after the last, [T + 1]."""
    steps = np.asarray(trace.columns["step"], dtype=np.int64)
    return np.append(steps, steps[-1] + 1)


def driven_ways(trace: EpisodeTrace) -> tuple[NDArray[np.int64], Floats]:
    """Rows of the steps whose way is known, [N], and both ends of each way, [N, 2, 2], m.

    Where a log lacks the step that follows, it does not tell where the car went.
    """
    rows = np.flatnonzero(np.diff(steps_of(trace)) == 1)
    return rows, np.stack([trace.poses[rows, :2], trace.poses[rows + 1, :2]], axis=1)


def trail_colours(trace: EpisodeTrace, theme: Theme) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """The colours of the line driven, and which of them each step has, [T]: by speed if that varies, else by action."""
    if trace.speeds is None:
        return theme.action_colours(len(trace.scene.action_names)), trace.actions
    return theme.speed_shades, speed_shades_of(trace.speeds[:-1], *speed_span(trace.speeds))


def speed_span(speeds: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Between which speeds, m/s, colours differ."""
    return float(speeds.min()), float(speeds.max())


def speed_shades_of(speeds: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.int64]:
    """Which of the `SHADES` colours each of the speeds has, [T]."""
    return np.clip((speeds - low) / (high - low) * SHADES, 0, SHADES - 1).astype(np.int64)
