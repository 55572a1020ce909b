"""A track: a closed road between two walls, with directed gates across it.

Shapes: `P` points of the centreline, `S` walls, `G` gates, `B` cars. Lengths are in metres, angles in radians
counter-clockwise from +x. A *station* is a distance along the centreline from the start line, in driving order.
"""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from shapely import LinearRing
from torch import Tensor

from carrl.errors import TrackError
from carrl.sim import builtin
from carrl.sim.centreline import Centreline, read_csv

DEFAULT_GATE_SPACING = 30.0
"""Distance between gates on a track from a file, m; the paper's track has its 8 gates about as far apart."""
MIN_GATE_SPACING = 1.0
_AT_GATE = 0.1
"""A start this close before a gate, m, lies behind it: where the widths change, the gate's straight line between the
walls meets the centreline some centimetres off its station (4 cm on the Moscow Raceway)."""


@dataclass(frozen=True, eq=False)
class Track:
    """A closed circuit.

    Attributes:
        name: a built-in track's name, or the name of the file it came from.
        centreline: [P, 2], float32, m, in driving order; the last point joins the first. Point 0 is the start.
        left_wall: the left wall at each centreline point, [P, 2], float32, m.
        right_wall: the right wall at each centreline point, [P, 2], float32, m.
        gate_count: how many gates, evenly spaced; the last one is the start line, so passing it completes a lap.
    """

    name: str
    centreline: Tensor
    left_wall: Tensor
    right_wall: Tensor
    gate_count: int

    @staticmethod
    def load(name_or_path: str | Path, gate_spacing: float | None = None) -> "Track":
        """Loads a built-in track by name, or a centreline file by path.

        Args:
            name_or_path: one of `builtin_names()`, or a CSV file with the columns `x_m, y_m, w_tr_right_m,
                w_tr_left_m`, as in the TUM racetrack database.
            gate_spacing: about how far the gates stand apart, m; by default the built-in track's own gates, and
                `DEFAULT_GATE_SPACING` for a file.

        Raises:
            TrackError: there is no such track, or the file does not describe one.
        """
        name = str(name_or_path)
        is_number = isinstance(gate_spacing, int | float)
        if gate_spacing is not None and not (is_number and gate_spacing >= MIN_GATE_SPACING):
            raise TrackError(
                f"track '{name}': gate_spacing is {gate_spacing}; it must be a number of at least {MIN_GATE_SPACING} m"
            )
        if name in builtin.DRAWINGS:
            drawing = builtin.DRAWINGS[name]
            centreline = drawing.centreline()
            gate_count = None if gate_spacing else drawing.gate_count
        else:
            path = Path(name_or_path)
            if not os.path.exists(path):  # Path.exists raises on a name that is too long or may not be looked up.
                raise TrackError(
                    f"track '{name}': no file of this path and no built-in track of this name; "
                    f"the built-in ones are {', '.join(builtin_names())}"
                )
            name, centreline, gate_count = path.name, read_csv(path), None
        return Track.from_centreline(name, centreline, gate_spacing or DEFAULT_GATE_SPACING, gate_count)

    @staticmethod
    def from_centreline(
        name: str, centreline: Centreline, gate_spacing: float = DEFAULT_GATE_SPACING, gate_count: int | None = None
    ) -> "Track":
        """Builds the walls by offsetting the centreline, and the gates by `gate_count` or else by `gate_spacing` m.

        Raises:
            TrackError: the centreline crosses itself.
        """
        ring = LinearRing(centreline.points)
        if not ring.is_simple:
            raise TrackError(
                f"track '{name}': the centreline crosses itself; bridges and crossings are not supported, "
                "so use a circuit whose road never meets itself"
            )
        left, right = centreline.walls()
        return Track(
            name=name,
            centreline=torch.from_numpy(centreline.points.astype(np.float32)),
            left_wall=torch.from_numpy(left.astype(np.float32)),
            right_wall=torch.from_numpy(right.astype(np.float32)),
            gate_count=gate_count or max(3, round(ring.length / gate_spacing)),
        )

    @cached_property
    def walls(self) -> Tensor:
        """Every wall as a pair of end points, left walls first, [S, 2, 2], float32, m."""
        sides = (self.left_wall, self.right_wall)
        return torch.cat([torch.stack([side, side.roll(-1, 0)], dim=1) for side in sides])

    @cached_property
    def gates(self) -> Tensor:
        """The gates in driving order as (left end, right end), [G, 2, 2], float32, m."""
        ends = [self._interpolate(side, self.gate_stations) for side in (self.left_wall, self.right_wall)]
        return torch.stack(ends, dim=1).float()

    @cached_property
    def gate_stations(self) -> Tensor:
        """Where the gates stand along the centreline, increasing, the last at `length`, [G], float64, m."""
        return torch.arange(1, self.gate_count + 1, dtype=torch.float64) * self.length / self.gate_count

    @property
    def length(self) -> float:
        """Length of the centreline, m."""
        return self._stations[-1].item()

    def pose_at(self, stations: Tensor) -> Tensor:
        """Poses on the centreline, in the driving direction: stations [B], m, to [B, 3], float32, m, m, rad."""
        segment = self._segment_at(stations)
        direction = (self.centreline.roll(-1, 0) - self.centreline)[segment]
        heading = torch.atan2(direction[:, 1], direction[:, 0])
        position = self._interpolate(self.centreline, stations)
        return torch.cat([position.float(), heading[:, None]], dim=-1)

    def next_gate(self, stations: Tensor) -> Tensor:
        """Index of the first gate ahead of each station: [B], m, to [B], int64; one within 0.1 m lies behind."""
        ahead = torch.searchsorted(self.gate_stations, stations.double() % self.length + _AT_GATE)
        return ahead % self.gate_count

    def station_near(self, position: Tensor, low: Tensor, high: Tensor) -> Tensor:
        """The station of the centreline point nearest to each position, searched between two stations only.

        The road may come close to itself, so the nearest point of the whole centreline can be on another stretch.

        Args:
            position: [B, 2], m.
            low: where to begin to search, [B], m.
            high: where to end, [B], m, at least `low`; may exceed `length` by up to a lap.

        Returns:
            [B], float64, m, between `low` and `high`.
        """
        samples = torch.linspace(0, 1, 257, dtype=torch.float64)
        stations = low.double()[:, None] + (high - low).double()[:, None] * samples
        points = self._interpolate(self.centreline, stations.flatten()).view(*stations.shape, 2)
        nearest = torch.linalg.vector_norm(points - position.double()[:, None], dim=-1).argmin(dim=1)
        return stations.gather(1, nearest[:, None])[:, 0]

    def as_dict(self) -> dict[str, Any]:
        """The geometry as plain values in metres, ready for JSON."""
        return {
            "name": self.name,
            "length": self.length,
            "centreline": self.centreline.tolist(),
            "walls": self.walls.tolist(),
            "gates": self.gates.tolist(),
        }

    @cached_property
    def _stations(self) -> Tensor:
        """Stations of the centreline's points and, at the end, the length: [P + 1], float64."""
        steps = torch.linalg.vector_norm((self.centreline.roll(-1, 0) - self.centreline).double(), dim=1)
        return torch.cat([steps.new_zeros(1), steps.cumsum(0)])

    def _segment_at(self, stations: Tensor) -> Tensor:
        after = torch.searchsorted(self._stations, stations.double() % self.length, right=True)
        return (after - 1).clamp(0, len(self.centreline) - 1)

    def _interpolate(self, points: Tensor, stations: Tensor) -> Tensor:
        """The points [P, 2] of a side or the centreline, at stations [B]: [B, 2], float64."""
        segment = self._segment_at(stations)
        begin, end = self._stations[segment], self._stations[segment + 1]
        share = ((stations.double() % self.length - begin) / (end - begin))[:, None]
        points = points.double()
        return points[segment] + share * (points.roll(-1, 0) - points)[segment]


def builtin_names() -> list[str]:
    """Names of the tracks that come with CarRL, easiest first."""
    return list(builtin.DRAWINGS)
