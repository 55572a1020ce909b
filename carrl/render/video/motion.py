"""Where the car is at every frame of a video: between two steps of the log, on the arc from one to the other.

Shapes: `F` frames, `T` steps, `R` rays.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import steps_of

JUMP = 0.2
"""A ray whose reading changes by more than this share of its range within a step has met another wall."""


@dataclass(frozen=True, eq=False)
class Motion:
    """An episode at equally spaced moments.

    Attributes:
        steps: the step that is being made, [F].
        shares: how much of it is done, [F], in [0, 1]; 1 only at the very end.
        poses: x m, y m, heading rad, [F, 3].
        ranges: of the rays, [F, R], m.
    """

    steps: NDArray[np.int64]
    shares: Floats
    poses: Floats
    ranges: Floats

    def __len__(self) -> int:
        """Frames, F."""
        return len(self.steps)


def motion_of(trace: EpisodeTrace, rate: float) -> Motion:
    """The episode at so many moments per simulated second, the last one at its end."""
    steps_per_frame = 1 / (rate * trace.scene.time_step)
    # The margin keeps rounding from showing a step one frame late.
    progress = np.append(np.arange(0, len(trace) - 1e-6, steps_per_frame) + 1e-9, len(trace))
    steps = np.minimum(progress.astype(np.int64), len(trace) - 1)
    shares = progress - steps
    return Motion(steps, shares, _poses_between(trace, steps, shares), _ranges_between(trace, steps, shares))


def _poses_between(trace: EpisodeTrace, steps: NDArray[np.int64], shares: Floats) -> Floats:
    """Poses on the arcs of constant curvature from one pose to the next, [F, 3]; the first where a step is missing."""
    known = np.diff(steps_of(trace)) == 1
    begin, end = trace.poses[steps], trace.poses[steps + known[steps]]
    chord = end[:, :2] - begin[:, :2]
    yaw = (end[:, 2] - begin[:, 2] + np.pi) % (2 * np.pi) - np.pi
    # A part of an arc has a shorter chord, turned back by half of the turn that is still to come.
    length = np.linalg.norm(chord, axis=1) * shares * np.sinc(shares * yaw / 2 / np.pi) / np.sinc(yaw / 2 / np.pi)
    direction = np.arctan2(chord[:, 1], chord[:, 0]) - (1 - shares) * yaw / 2
    return np.column_stack(
        [
            begin[:, 0] + length * np.cos(direction),
            begin[:, 1] + length * np.sin(direction),
            begin[:, 2] + shares * yaw,
        ]
    )


def _ranges_between(trace: EpisodeTrace, steps: NDArray[np.int64], shares: Floats) -> Floats:
    """Ranges in proportion, or where a ray leaves one wall for another, the nearer of the two in time, [F, R]."""
    known = np.diff(steps_of(trace)) == 1
    begin, end = trace.ranges[steps], trace.ranges[steps + known[steps]]
    share = shares[:, None]
    jumps = np.abs(end - begin) > JUMP * trace.scene.sensor_range
    return np.asarray(begin + np.where(jumps, share >= 0.5, share) * (end - begin))
