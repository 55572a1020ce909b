"""Places along tracks: the centrelines of any number of tracks, end to end, so that each car may be on its own.

Shapes: `T` tracks, `P` points of all centrelines, `G` gates of all tracks, `B` cars. Lengths are in metres, angles in
radians counter-clockwise from +x. A *station* is a distance along one centreline from its start line, in driving order;
a *milestone* is a distance along all of them.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

_AT_GATE = 0.1
"""A start this close before a gate, m, lies behind it: where the widths change, the gate's straight line between the
walls meets the centreline some centimetres off its station (4 cm on the Moscow Raceway)."""
_SEARCH_SAMPLES = 257


class Routes:
    """The centrelines of tracks, on the CPU. Stations may be negative or more than a lap.

    It computes in NumPy, which takes half as long as torch for the few cars that start at a time.

    Args:
        roads: points of the centreline, the left and the right wall of each track, [P, 3, 2], float32, m.
        gate_counts: how many gates each track has.

    Attributes:
        lengths: of the centrelines, [T], float64, m.
        segment_middles: milestones of the middles of the centrelines' segments, [P], float64, m.
    """

    def __init__(self, roads: Sequence[Tensor], gate_counts: Sequence[int]) -> None:
        """Lays the centrelines end to end."""
        begin, end = torch.cat(list(roads)), torch.cat([road.roll(-1, 0) for road in roads])
        way = (end - begin)[:, 0]
        steps = torch.linalg.vector_norm(way.double(), dim=1).split([len(road) for road in roads])
        stations = [torch.cat([each.new_zeros(1), each.cumsum(0)]) for each in steps]
        self.lengths = torch.stack([each[-1] for each in stations])
        bases = self.lengths.cumsum(0) - self.lengths
        segment_begin = torch.cat([base + each[:-1] for base, each in zip(bases, stations, strict=True)])
        segment_end = torch.cat([base + each[1:] for base, each in zip(bases, stations, strict=True)])
        self.segment_middles = (segment_begin + segment_end) / 2
        # A copy: torch moves a tensor's memory when it hands the tensor to another process.
        self._lengths, self._bases = self.lengths.numpy().copy(), bases.numpy()
        self._headings = torch.atan2(way[:, 1], way[:, 0]).numpy()
        self._begin, self._edge = begin.double().numpy(), (end.double() - begin.double()).numpy()
        self._segment_begin, self._segment_end = segment_begin.numpy(), segment_end.numpy()
        self._last_segment = np.cumsum([len(road) for road in roads]) - 1
        self._gate_counts = np.array(gate_counts)
        self._first_gate = self._gate_counts.cumsum() - self._gate_counts
        self._gates = np.concatenate([base + self.gates_of(index).numpy() for index, base in enumerate(self._bases)])

    def gates_of(self, track: int) -> Tensor:
        """Stations of the gates of one track: evenly spaced, the last at its length, [G], float64, m."""
        count = int(self._gate_counts[track])
        return torch.arange(1, count + 1, dtype=torch.float64) * self.lengths[track] / count

    def poses(self, track: Tensor, stations: Tensor) -> Tensor:
        """Poses on the centreline, in the driving direction: [B] and [B], m, to [B, 3], float32, m, m, rad."""
        segment, points = self._points_at(track.numpy(), stations.numpy())
        poses = np.empty((len(segment), 3), np.float32)
        poses[:, :2], poses[:, 2] = points[:, 0], self._headings[segment]
        return torch.from_numpy(poses)

    def walls(self, track: Tensor, stations: Tensor) -> Tensor:
        """Where the left and the right wall stand, at stations [B], m: [B, 2, 2], float64, m."""
        return torch.from_numpy(self._points_at(track.numpy(), stations.numpy())[1][:, 1:])

    def clearance(self, track: Tensor, stations: Tensor) -> Tensor:
        """How far the walls are from the centreline, left and right: [B] and [B], m, to [B, 2], float64, m.

        Measured square to the heading of `poses`, so that a car can be moved sideways by that much.
        """
        segment, found = self._points_at(track.numpy(), stations.numpy())
        heading, points = torch.from_numpy(self._headings[segment]).double(), torch.from_numpy(found)
        to_left = torch.stack([-heading.sin(), heading.cos()], dim=-1)[:, None]
        outward = points.new_tensor([1.0, -1.0])
        return (((points[:, 1:] - points[:, :1]) * to_left).sum(-1) * outward).clamp(min=0)

    def next_gate(self, track: Tensor, stations: Tensor) -> Tensor:
        """Index of the first gate ahead of each station: [B] and [B], m, to [B]; one within 0.1 m lies behind."""
        own = track.numpy()
        ahead = self._gates.searchsorted(self._milestones(own, stations.numpy()) + _AT_GATE)
        return torch.from_numpy((ahead - self._first_gate[own]) % self._gate_counts[own])

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
        _, points = self._points_at(track.repeat_interleave(_SEARCH_SAMPLES).numpy(), stations.flatten().numpy())
        away = torch.from_numpy(points[:, 0]).view(*stations.shape, 2) - position.double()[:, None]
        nearest = torch.linalg.vector_norm(away, dim=-1).argmin(dim=1)
        return stations.gather(1, nearest[:, None])[:, 0]

    def _milestones(self, track: np.ndarray, stations: np.ndarray) -> np.ndarray:
        return self._bases[track] + stations.astype(np.float64, copy=False) % self._lengths[track]

    def _points_at(self, track: np.ndarray, stations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The segment [B], and there the points of the centreline, the left and the right wall, [B, 3, 2], float64."""
        milestones = self._milestones(track, stations)
        segment = self._segment_begin.searchsorted(milestones, side="right") - 1
        segment = np.minimum(np.maximum(segment, 0), self._last_segment[track])
        begin, end = self._segment_begin[segment], self._segment_end[segment]
        share = ((milestones - begin) / (end - begin))[:, None, None]
        return segment, self._begin[segment] + share * self._edge[segment]
