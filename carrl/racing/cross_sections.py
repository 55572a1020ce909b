"""The road as lines from wall to wall.

Shapes: `N` stations. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from carrl.tracks.track import Track

Floats = NDArray[np.float64]


class WallFrames(NamedTuple):
    """One wall at each station: where it is, where it leads, and how it bends.

    Attributes:
        point: [N, 2], m.
        along: unit vector in the driving direction, [N, 2].
        inward: unit vector into the road, [N, 2].
        bend: curvature into the road, [N], 1/m.
    """

    point: Floats
    along: Floats
    inward: Floats
    bend: Floats

    @property
    def columns(self) -> Floats:
        """All of it, one column a station, [7, N]."""
        return np.vstack([self.point.T, self.along.T, self.inward.T, self.bend[None]])


@dataclass(frozen=True, eq=False)
class CrossSections:
    """Lines across a closed road, spaced evenly along its centreline.

    Attributes:
        stations: along the centreline, [N], m.
        left: where each meets the left wall, [N, 2], m.
        right: where it meets the right wall, [N, 2], m.
        behind: the left and the right wall a little before the line, [N, 2, 2], m.
        ahead: likewise after it.
        reach: how far that is along the centreline, m.
        track_length: of the centreline, m.
    """

    stations: Floats
    left: Floats
    right: Floats
    behind: Floats
    ahead: Floats
    reach: float
    track_length: float

    @staticmethod
    def of(track: "Track", spacing: float, reach: float) -> "CrossSections":
        """Those of a track, at most `spacing` apart, m, with the walls known up to `reach` from each, m."""
        road = track.road.double().numpy()
        steps = np.linalg.norm(np.roll(road[:, 0], -1, axis=0) - road[:, 0], axis=1)
        ends = np.append(0, steps.cumsum())
        length = float(ends[-1])
        count = max(8, math.ceil(length / spacing))
        stations = np.arange(count) * length / count
        columns = np.concatenate([road, road[:1]]).reshape(len(road) + 1, 6).T

        def walls_at(places: Floats) -> Floats:
            points = np.stack([np.interp(places % length, ends, column) for column in columns], axis=1)
            return points.reshape(count, 3, 2)[:, 1:]

        here, behind, ahead = (walls_at(stations + away) for away in (0.0, -reach, reach))
        return CrossSections(stations, here[:, 0], here[:, 1], behind, ahead, reach, length)

    @property
    def spacing(self) -> float:
        """From station to station, m."""
        return self.track_length / len(self.stations)

    @cached_property
    def middle(self) -> Floats:
        """Half-way between the walls, [N, 2], m."""
        return (self.left + self.right) / 2

    @cached_property
    def width(self) -> Floats:
        """From wall to wall, [N], m."""
        return np.linalg.norm(self.left - self.right, axis=1)

    @cached_property
    def across(self) -> Floats:
        """Unit vectors from the right wall to the left one, [N, 2]."""
        return (self.left - self.right) / self.width[:, None]

    @cached_property
    def heading(self) -> Floats:
        """Square to the line across, in the driving direction, counted on through full turns, [N], rad."""
        return np.unwrap(np.arctan2(-self.across[:, 0], self.across[:, 1]))

    @cached_property
    def turn(self) -> float:
        """By how much the road turns in a lap, rad."""
        rest = (self.heading[0] - self.heading[-1] + math.pi) % (2 * math.pi) - math.pi
        return float(self.heading[-1] + rest - self.heading[0])

    @cached_property
    def columns(self) -> Floats:
        """Middle, line across and heading, one column a station, [5, N]."""
        return np.vstack([self.middle.T, self.across.T, self.heading[None]])

    @cached_property
    def columns_after(self) -> Floats:
        """`columns` of each station's successor, the heading counted on, [5, N]."""
        after = np.roll(self.columns, -1, axis=1)
        after[4, -1] += self.turn
        return after

    def walls(self) -> tuple[WallFrames, WallFrames]:
        """The left and the right wall as parabolas through where they are behind, here and ahead."""
        return self._frames(self.left, 0, -1.0), self._frames(self.right, 1, 1.0)

    def _frames(self, points: Floats, wall: int, side: float) -> WallFrames:
        """`side` is 1 where the road is to the left of the wall; the tip of a fold is taken for round."""
        before, after = points - self.behind[:, wall], self.ahead[:, wall] - points
        chord = before + after
        length, first, second = (np.linalg.norm(each, axis=1).clip(1e-9) for each in (chord, before, after))
        along = chord / length[:, None]
        inward = side * np.stack([-along[:, 1], along[:, 0]], axis=1)
        area = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        bend = side * 2 * area / (first * second * length).clip(1e-9)
        return WallFrames(points, along, inward, bend.clip(-1 / self.reach, 1 / self.reach))
