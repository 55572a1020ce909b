"""Roads and walls that the simulator's tests drive on."""

import math

import numpy as np
import torch
from torch import Tensor

from carrl.tracks.centreline import Centreline
from carrl.tracks.drawing_file import rounded_polygon
from carrl.tracks.track import Track

Walls = list[tuple[tuple[float, float], tuple[float, float]]]


def square_room(half_side: float = 10.0, dtype: torch.dtype = torch.float32) -> Tensor:
    """Four walls about the origin, [4, 2, 2], m."""
    a = half_side
    corners = torch.tensor([[-a, -a], [a, -a], [a, a], [-a, a]], dtype=dtype)
    return torch.stack([corners, corners.roll(-1, 0)], dim=1)


def straight_road_track(straight: float = 200.0, width: float = 10.0, gate_count: int = 8) -> Track:
    """A stadium driven counter-clockwise: from (0, 0) along +x, half circles of radius 30 m at both ends."""
    radius, spacing = 30.0, 2.0
    points = [(x, 0.0) for x in np.arange(0, straight, spacing)]
    turn = np.arange(0, math.pi, spacing / radius)
    points += [(straight + radius * math.sin(a), radius - radius * math.cos(a)) for a in turn]
    points += [(straight - x, 2 * radius) for x in np.arange(0, straight, spacing)]
    points += [(-radius * math.sin(a), radius + radius * math.cos(a)) for a in turn]
    half = np.full(len(points), width / 2)
    return Track.from_centreline("stadium", Centreline(np.array(points), half, half), gate_count=gate_count)


def random_track(seed: int) -> Track:
    """A closed road of random shape, size and, from point to point, width; its walls may fold in sharp turns."""
    random = np.random.default_rng(seed)
    count = int(random.integers(12, 60))
    angle = (np.arange(count) + random.uniform(-0.3, 0.3, count)) * 2 * math.pi / count
    waves = sum(random.uniform(0, 0.15) * np.cos(k * angle + random.uniform(0, 6.28)) for k in range(2, 6))
    radius = random.uniform(20, 80) * (1 + waves)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) + random.uniform(-200, 200, 2)
    right, left = random.uniform(3, 6, (2, count))
    return Track.from_centreline(f"random {seed}", Centreline(points, right, left))


def random_poses(track: Track, count: int, seed: int) -> Tensor:
    """Poses [count, 3], float32: the first half on the road, the others anywhere near the track."""
    generator = torch.Generator().manual_seed(seed)
    pose = track.pose_at(torch.rand(count, generator=generator) * track.length)
    pose[:, :2] += 2.5 * (2 * torch.rand(count, 2, generator=generator) - 1)
    low, high = track.walls.flatten(0, 1).amin(0) - 10, track.walls.flatten(0, 1).amax(0) + 10
    pose[count // 2 :, :2] = low + (high - low) * torch.rand(count - count // 2, 2, generator=generator)
    pose[:, 2] = math.pi * (2 * torch.rand(count, generator=generator) - 1)
    return pose


def as_floats(segments: Tensor) -> Walls:
    """Segments [S, 2, 2] as the plain floats that the scalar oracles take."""
    return [tuple(map(tuple, segment)) for segment in segments.double().tolist()]


def rounded_road(corners: list[tuple[float, float]], radius: float, width: float, point_spacing: float = 2.0) -> Track:
    """A road along a polygon with rounded corners."""
    points = rounded_polygon(np.array(corners, dtype=float), radius, point_spacing)
    half = np.full(len(points), width / 2)
    return Track.from_centreline("rounded", Centreline(points, half, half))


def figure_eight(width: float = 8.0, spacing: float = 2.0, turn: float = 0.0) -> Track:
    """Gerono's curve, 160 m by 80 m, which crosses itself in the origin; from the right end on, or `turn` later."""
    angle = turn + np.linspace(0, 2 * math.pi, round(420 / spacing), endpoint=False)
    points = np.stack([80 * np.cos(angle), 40 * np.sin(2 * angle)], axis=1)
    half = np.full(len(points), width / 2)
    return Track.from_centreline("eight", Centreline(points, half, half))
