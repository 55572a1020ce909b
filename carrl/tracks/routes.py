"""Places along tracks: the centrelines of any number of tracks, end to end, so that each car may be on its own.

Shapes: `T` tracks, `P` points of all centrelines, `G` gates of all tracks, `B` cars. Lengths are in metres, angles in
radians counter-clockwise from +x. A *station* is a distance along one centreline from its start line, in driving order;
a *milestone* is a distance along all of them.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from carrl.tracks.track import Track

_AT_GATE = 0.1
"""A start this close before a gate, m, lies behind it: where the widths change, the gate's straight line between the
walls meets the centreline some centimetres off its station (4 cm on the Moscow Raceway)."""
_SEARCH_SAMPLES = 257


class Routes:
    """The centrelines of tracks, on the CPU. Stations may be negative or more than a lap.

    Attributes:
        lengths: of the centrelines, [T], float64, m.
        segment_middles: milestones of the middles of the centrelines' segments, [P], float64, m.
    """

    def __init__(self, tracks: Sequence["Track"]) -> None:
        """Lays the centrelines end to end."""
        lines = [torch.stack([track.centreline, track.left_wall, track.right_wall], dim=1) for track in tracks]
        begin, end = torch.cat(lines), torch.cat([line.roll(-1, 0) for line in lines])
        way = (end - begin)[:, 0]
        steps = torch.linalg.vector_norm(way.double(), dim=1).split([len(line) for line in lines])
        stations = [torch.cat([each.new_zeros(1), each.cumsum(0)]) for each in steps]
        self.lengths = torch.stack([each[-1] for each in stations])
        self._headings = torch.atan2(way[:, 1], way[:, 0])
        self._begin, self._edge = begin.double(), end.double() - begin.double()
        self._base = self.lengths.cumsum(0) - self.lengths
        self._segment_begin = torch.cat([base + each[:-1] for base, each in zip(self._base, stations, strict=True)])
        self._segment_end = torch.cat([base + each[1:] for base, each in zip(self._base, stations, strict=True)])
        self.segment_middles = (self._segment_begin + self._segment_end) / 2
        self._last_segment = torch.tensor([len(line) for line in lines]).cumsum(0) - 1
        self._gate_counts = torch.tensor([track.gate_count for track in tracks])
        self._first_gate = self._gate_counts.cumsum(0) - self._gate_counts
        self._gates = torch.cat([base + self.gates_of(index) for index, base in enumerate(self._base)])

    def gates_of(self, track: int) -> Tensor:
        """Stations of the gates of one track: evenly spaced, the last at its length, [G], float64, m."""
        count = int(self._gate_counts[track])
        return torch.arange(1, count + 1, dtype=torch.float64) * self.lengths[track] / count

    def poses(self, track: Tensor, stations: Tensor) -> Tensor:
        """Poses on the centreline, in the driving direction: [B] and [B], m, to [B, 3], float32, m, m, rad."""
        segment, points = self._points_at(track, stations)
        return torch.cat([points[:, 0].float(), self._headings[segment, None]], dim=-1)

    def walls(self, track: Tensor, stations: Tensor) -> Tensor:
        """Where the left and the right wall stand, at stations [B], m: [B, 2, 2], float64, m."""
        return self._points_at(track, stations)[1][:, 1:]

    def room(self, track: Tensor, stations: Tensor) -> Tensor:
        """How far the walls are from the centreline, left and right: [B] and [B], m, to [B, 2], float64, m.

        Measured square to the heading of `poses`, so that a car can be moved sideways by that much.
        """
        segment, points = self._points_at(track, stations)
        heading = self._headings[segment].double()
        to_left = torch.stack([-heading.sin(), heading.cos()], dim=-1)[:, None]
        outward = points.new_tensor([1.0, -1.0])
        return (((points[:, 1:] - points[:, :1]) * to_left).sum(-1) * outward).clamp(min=0)

    def next_gate(self, track: Tensor, stations: Tensor) -> Tensor:
        """Index of the first gate ahead of each station: [B] and [B], m, to [B]; one within 0.1 m lies behind."""
        ahead = torch.searchsorted(self._gates, self._milestones(track, stations) + _AT_GATE)
        return (ahead - self._first_gate[track]) % self._gate_counts[track]

    def nearest_stations(self, track: Tensor, position: Tensor, low: Tensor, high: Tensor) -> Tensor:
        """The station of the centreline point nearest to each position, searched between two stations only.

        The road may come close to itself, so the nearest point of the whole centreline can be on another stretch.

        Args:
            track: [B], int64.
            position: [B, 2], m.
            low: where to begin to search, [B], m.
            high: where to end, [B], m, at least `low`; may exceed the length by up to a lap.

        Returns:
            [B], float64, m, between `low` and `high`.
        """
        samples = torch.linspace(0, 1, _SEARCH_SAMPLES, dtype=torch.float64)
        stations = low.double()[:, None] + (high - low).double()[:, None] * samples
        _, points = self._points_at(track.repeat_interleave(_SEARCH_SAMPLES), stations.flatten())
        away = points[:, 0].view(*stations.shape, 2) - position.double()[:, None]
        nearest = torch.linalg.vector_norm(away, dim=-1).argmin(dim=1)
        return stations.gather(1, nearest[:, None])[:, 0]

    def _milestones(self, track: Tensor, stations: Tensor) -> Tensor:
        return self._base[track] + stations.double() % self.lengths[track]

    def _points_at(self, track: Tensor, stations: Tensor) -> tuple[Tensor, Tensor]:
        """The segment [B], and there the points of the centreline, the left and the right wall, [B, 3, 2], float64."""
        milestones = self._milestones(track, stations)
        segment = torch.searchsorted(self._segment_begin, milestones, right=True) - 1
        segment = segment.clamp(min=0).minimum(self._last_segment[track])
        begin, end = self._segment_begin[segment], self._segment_end[segment]
        share = ((milestones - begin) / (end - begin))[:, None, None]
        return segment, self._begin[segment] + share * self._edge[segment]
