"""The walls of a track as lines that can be drawn in one go."""

import numpy as np

from carrl.log.scene import Floats, TrackShape


def connected_walls(track: TrackShape) -> list[Floats]:
    """The walls as lines of points, [N, 2] each, m: each goes on where the next wall begins.

    Most tracks have two, the left and the right one, each closed: its last point is its first.
    """
    breaks = np.flatnonzero((track.walls[1:, 0] != track.walls[:-1, 1]).any(axis=1)) + 1
    return [np.vstack([line[:, 0], line[-1:, 1]]) for line in np.split(track.walls, breaks)]
