"""Lines and points of an episode that more than one viewer draws.

Shapes: `T` steps, `R` rays, `N` steps whose way is known.
"""

import numpy as np
from numpy.typing import NDArray

from carrl.log.scene import Floats, Scene
from carrl.log.trace import EpisodeTrace


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


def ray_hits(trace: EpisodeTrace) -> NDArray[np.bool_]:
    """Whether each ray meets a wall and does not end in the air, before each step and after the last, [T + 1, R]."""
    return trace.ranges < trace.scene.sensor_range


def ray_directions(scene: Scene) -> Floats:
    """Unit vectors along the rays, x ahead and y to the left of the car, [R, 2]."""
    return np.stack([np.cos(scene.sensor_angles), np.sin(scene.sensor_angles)], axis=1)
