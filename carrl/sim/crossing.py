"""Where cars cross a line across the road, and when within the step.

All in NumPy, since logs are read without torch.

Shapes: `N` ways of a car in one step each, or any other leading shape.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AT_LINE = 1e-3
"""A car that ends its step no more than this before a line, m, has crossed it: rounding must not put the line where a
drive began, and the gate in the same place, in two steps."""


def crossing_shares(lines: Floats, begin: Floats, end: Floats) -> Floats:
    """The share of its way at which each car crosses its line forward.

    Args:
        lines: left and right end, seen in the driving direction, [N, 2, 2] or one for all [2, 2], m.
        begin: of the ways, [N, 2], m.
        end: [N, 2], m.

    Returns:
        [N]; from 0 on, and no more than `AT_LINE` beyond 1. Not a number where the line is not crossed, or is crossed
        backwards or beside its ends.
    """
    left, across = lines[..., 0, :], lines[..., 1, :] - lines[..., 0, :]
    width = np.hypot(across[..., 0], across[..., 1])
    forward = np.stack([-across[..., 1], across[..., 0]], axis=-1) / width[..., None]
    before, after = (((point - left) * forward).sum(-1) for point in (begin, end))
    crosses = (before < -AT_LINE) & (after >= -AT_LINE)
    share = -before / np.where(crosses, after - before, 1.0)
    aside = ((begin + share[..., None] * (end - begin) - left) * across).sum(-1) / width
    is_between = (aside >= -AT_LINE) & (aside <= width + AT_LINE)
    return np.where(crosses & is_between, share, np.nan)


def time_shares(way_shares: Floats, speed_before: Floats, speed_after: Floats) -> Floats:
    """The share of a step's time after which a share of its way is done, where the speed changes evenly.

    With v^2 growing evenly along the way, the time is the way over the mean of the speeds at both of its ends.

    Args:
        way_shares: [N].
        speed_before: the step, [N], m/s.
        speed_after: [N], m/s.

    Returns:
        [N]; the share of the way itself where neither speed is positive.
    """
    speed = np.sqrt(np.maximum(speed_before**2 + (speed_after**2 - speed_before**2) * way_shares, 0.0))
    mean = speed_before + speed
    share = way_shares * (speed_before + speed_after) / np.where(mean > 0, mean, 1.0)
    return np.where(mean > 0, share, way_shares)
