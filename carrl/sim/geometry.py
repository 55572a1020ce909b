"""Exact batched intersections and distances between points, rays and wall segments.

Shapes: `B` cars, `R` rays, `S` segments. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math

import numpy as np
import shapely
import torch
from torch import Tensor

# Rays and walls that meet at a shared end point must not slip through the joint by a rounding error.
_JOINT_TOLERANCE = 1e-9


def cross(a: Tensor, b: Tensor) -> Tensor:
    """The z component of the cross product of 2D vectors: positive where `b` points to the left of `a`."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def ray_distances(origins: Tensor, angles: Tensor, segments: Tensor, max_range: float) -> Tensor:
    """The distance along each ray to the first segment it meets.

    Computed in float64 and rounded once: a ray that grazes a wall at angle a amplifies rounding by 1 / sin(a),
    which in float32 puts about one ray in a thousand more than 0.1 mm off.

    Args:
        origins: where the rays start, [B, 2], m.
        angles: where they point, [B, R], rad, in the same frame as the segments.
        segments: the same for all, [S, 2, 2], or each origin's own, [B, S, 2, 2], m.
        max_range: the distance reported where a ray meets nothing nearer, m.

    Returns:
        [B, R], the dtype of `origins`, m, in [0, max_range]. A ray that runs parallel to a segment does not meet it.
    """
    angles = angles.double()
    directions = torch.stack([angles.cos(), angles.sin()], dim=-1)[:, :, None]
    first, last = segments.double().unsqueeze(-4).unbind(-2)
    edges = last - first
    to_start = first - origins.double()[:, None, None]
    denominator = cross(directions, edges)
    distance = cross(to_start, edges) / denominator
    position = cross(to_start, directions) / denominator
    # Parallel rays divide by zero; inf and nan fail every comparison below.
    meets = (distance >= 0) & (position >= -_JOINT_TOLERANCE) & (position <= 1 + _JOINT_TOLERANCE)
    nearest = torch.where(meets, distance, max_range).amin(dim=-1)
    return nearest.clamp(max=max_range).to(origins.dtype)


def point_segment_distances(points: Tensor, starts: Tensor, ends: Tensor) -> Tensor:
    """The distance from points to segments, all broadcast against each other: [..., 2] to [...], m."""
    edges = ends - starts
    squared_length = (edges * edges).sum(-1).clamp(min=torch.finfo(edges.dtype).tiny)
    position = (((points - starts) * edges).sum(-1) / squared_length).clamp(0, 1)
    return torch.linalg.vector_norm(points - starts - position[..., None] * edges, dim=-1)


def crosses(starts: Tensor, ends: Tensor, segments: Tensor) -> Tensor:
    """Whether each path start-end properly crosses each segment: [B, 2], [B, 2], [S, 2, 2] to [B, S] bool.

    The segments may be each path's own, [B, S, 2, 2].
    """
    starts, ends = starts[:, None], ends[:, None]
    first, last = segments.unbind(-2)
    path, edges = ends - starts, last - first
    path_straddles = cross(edges, starts - first) * cross(edges, ends - first) < 0
    segment_straddles = cross(path, first - starts) * cross(path, last - starts) < 0
    return path_straddles & segment_straddles


def crosses_forward(begin: Tensor, end: Tensor, gate: Tensor) -> Tensor:
    """Whether each way begin-end, [B, 2], crosses its own gate (left end, right end), [B, 2, 2], forward: [B]."""
    left, across = gate[:, 0], gate[:, 1] - gate[:, 0]
    side_before, side_after = cross(across, begin - left), cross(across, end - left)
    share = (side_before / (side_before - side_after))[:, None]
    position = ((begin + share * (end - begin) - left) * across).sum(-1) / (across * across).sum(-1)
    return (side_before < 0) & (side_after >= 0) & (position >= 0) & (position <= 1)


def most_gates_per_step(gates: Tensor, step_length: float) -> int:
    """How many gates [G, 2, 2] the straight way of one step can cross at the most."""
    lines = shapely.linestrings(gates.numpy())
    gap = shapely.distance(lines, np.roll(lines, 1)).min()
    return len(gates) if gap * len(gates) <= step_length else math.floor(step_length / gap) + 1


def path_clearance(starts: Tensor, ends: Tensor, segments: Tensor) -> Tensor:
    """The least distance that each straight path start-end keeps from all segments.

    Args:
        starts: [B, 2], m.
        ends: [B, 2], m. May equal `starts`.
        segments: the same for all, [S, 2, 2], or each path's own, [B, S, 2, 2], m.

    Returns:
        [B], m; 0 where the path crosses a segment. Exact, since two segments that do not cross are nearest to each
        other at one of their four end points.
    """
    first, last = segments.unbind(-2)
    from_path = torch.minimum(
        point_segment_distances(starts[:, None], first, last), point_segment_distances(ends[:, None], first, last)
    )
    from_segments = torch.minimum(
        point_segment_distances(first, starts[:, None], ends[:, None]),
        point_segment_distances(last, starts[:, None], ends[:, None]),
    )
    clearance = torch.minimum(from_path, from_segments)
    return torch.where(crosses(starts, ends, segments), 0.0, clearance).amin(dim=-1)


def rectangle_touches(
    starts: Tensor, ends: Tensor, headings: Tensor, half_size: tuple[float, float], segments: Tensor
) -> Tensor:
    """Whether a rectangle that moves along each straight path start-end touches any segment on its way.

    A segment moved back along the path covers a parallelogram, which has no point inside the rectangle at the start if
    and only if an axis separates the two: one of the rectangle's own, or one square to the segment or to the path.

    Source: Gottschalk, Lin and Manocha 1996, "OBBTree", the separating axis theorem.

    Args:
        starts: of the rectangle's middle, [B, 2], m.
        ends: [B, 2], m. May equal `starts`.
        headings: of the rectangle, the same all the way, [B], rad.
        half_size: half of its length along the heading, and of its width, m.
        segments: the same for all, [S, 2, 2], or each path's own, [B, S, 2, 2], m.

    Returns:
        [B], bool.
    """
    forward = torch.stack([headings.cos(), headings.sin()], dim=-1)
    left = torch.stack([-headings.sin(), headings.cos()], dim=-1)
    first, last = (point - starts[:, None] for point in segments.unbind(-2))
    path = (ends - starts)[:, None]
    touches = torch.ones(first.shape[:-1], dtype=torch.bool, device=starts.device)
    for axis in (forward[:, None], left[:, None], _square_to(last - first), _square_to(path)):
        along, across = ((axis * own[:, None]).sum(-1).abs() for own in (forward, left))
        reach = half_size[0] * along + half_size[1] * across
        begin, end, way = ((axis * vector).sum(-1) for vector in (first, last, path))
        low, high = torch.minimum(begin, end) - way.clamp(min=0), torch.maximum(begin, end) - way.clamp(max=0)
        separates = (low >= reach) | (high <= -reach)
        touches &= ~(separates & ((axis != 0).any(-1)))
    return touches.any(dim=-1)


def corners_beyond(
    starts: Tensor, ends: Tensor, headings: Tensor, half_size: tuple[float, float], segments: Tensor
) -> Tensor:
    """Whether a rectangle has a corner beyond a wall at the end of its path, or its middle is beyond one.

    A point is beyond a wall if the straight line to it from one that is not crosses an odd number of segments.

    Args:
        starts: of the rectangle's middle, on the road, [B, 2], m.
        ends: [B, 2], m.
        headings: at the end, [B], rad.
        half_size: half of its length along the heading, and of its width, m.
        segments: the same for all, [S, 2, 2], or each rectangle's own, [B, S, 2, 2], m.

    Returns:
        [B], bool.
    """
    forward = half_size[0] * torch.stack([headings.cos(), headings.sin()], dim=-1)
    left = half_size[1] * torch.stack([-headings.sin(), headings.cos()], dim=-1)
    beyond = torch.zeros_like(headings, dtype=torch.bool)
    for corner in (forward + left, forward - left, left - forward, -forward - left, starts - ends):
        first, last = (point - ends[:, None] for point in segments.unbind(-2))
        line = corner[:, None]
        parts_ends = (cross(line, first) >= 0) != (cross(line, last) >= 0)  # half open, so that a joint counts once
        parts_line = (cross(last - first, -first) >= 0) != (cross(last - first, line - first) >= 0)
        beyond = beyond | ((parts_ends & parts_line).sum(dim=-1) % 2 == 1)
    return beyond


def _square_to(vectors: Tensor) -> Tensor:
    return torch.stack([-vectors[..., 1], vectors[..., 0]], dim=-1)
