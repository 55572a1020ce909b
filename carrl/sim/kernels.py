"""The simulator's step and sense as machine code for the CPU, one car at a time.

They compute what `carrl.sim.vehicle`, `carrl.sim.geometry` and `carrl.sim.simulator` state in torch; tests compare the
two. All is float64 and rounded to float32 once, but for the pose, which is moved in float32 as torch moves it.

Numba compiles them when they are first called, in about three seconds, and keeps the code in `__pycache__` beside this
file. Where that cannot be written it uses the user's cache folder; NUMBA_CACHE_DIR names another one. Where none can be
written, every process compiles anew.

Shapes: `B` cars, `R` rays, `S` walls, `G` gates. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
import torch
from torch import Tensor

from carrl.sim.vehicle import Vehicle

# Values of other modules are repeated here, since Numba's cache sees only changes to this file.
_LEFT, _RIGHT = 1, 2
_JOINT_TOLERANCE = 1e-9
_TINY = np.finfo(np.float64).tiny


class World(NamedTuple):
    """What stays the same from step to step; the arrays are C-contiguous and float64.

    Attributes:
        walls: x and y of each start, then of the way to the end, [S, 4], m.
        circles: x, y and radius of a circle about each wall, [3, S], m.
        gates: x and y of each left end, then of the way to the right end, [G, 4], m.
        fan: cosine and sine of each ray's angle from the heading, [R, 2].
        max_range: of the rays, m.
        step_length: distance driven in one step, m.
        yaw_per_step: change of heading in one turning step, rad.
        body_radius: of the disc that must not touch a wall, m.
        most_gates: how many gates one step can cross at the most.
    """

    walls: np.ndarray
    circles: np.ndarray
    gates: np.ndarray
    fan: np.ndarray
    max_range: float
    step_length: float
    yaw_per_step: float
    body_radius: float
    most_gates: int


class Kernels:
    """The compiled step and sense with the constants of one simulator: tensors in, tensors out, on the CPU.

    Args:
        walls: [S, 2, 2], m.
        gates: in driving order as (left end, right end), [G, 2, 2], m.
        ray_angles: counter-clockwise from the heading, [R], rad.
        max_range: of the rays, m.
        vehicle: the car.
        most_gates: how many gates one step can cross at the most.
    """

    def __init__(
        self, walls: Tensor, gates: Tensor, ray_angles: Tensor, max_range: float, vehicle: Vehicle, most_gates: int
    ) -> None:
        """Compiles at once, unless that was done before, so that no step takes longer than the others."""
        segments, angles = _as_segments(walls), ray_angles.double().numpy()
        self._world = World(
            walls=segments,
            circles=_bounding_circles(segments),
            gates=_as_segments(gates),
            fan=np.ascontiguousarray(np.stack([np.cos(angles), np.sin(angles)], axis=1)),
            max_range=float(max_range),
            step_length=float(vehicle.step_length),
            yaw_per_step=float(vehicle.yaw_per_step),
            body_radius=float(vehicle.body_radius),
            most_gates=most_gates,
        )
        no_pose, no_count = torch.zeros(0, 3), torch.zeros(0, dtype=torch.int64)
        self.step(no_pose, no_count, no_count, no_count)
        self.sense(no_pose)

    def sense(self, pose: Tensor) -> Tensor:
        """The distances along the rays: poses [B, 3] to [B, R], float32, m, in [0, max_range]."""
        return torch.from_numpy(_sense(self._world, _as_array(pose, torch.float32)))

    def step(self, pose: Tensor, next_gate: Tensor, gates_passed: Tensor, action: Tensor) -> tuple[Tensor, ...]:
        """Moves every car by one time step.

        Returns:
            The pose [B, 3], next gate [B] and gates passed since the start [B]; then, of this step, the ranges
            [B, R], the collisions [B] and the gates passed [B].
        """
        counts = [_as_array(count, torch.int64) for count in (next_gate, gates_passed, action)]
        return tuple(map(torch.from_numpy, _step(self._world, _as_array(pose, torch.float32), *counts)))


def _as_array(tensor: Tensor, dtype: torch.dtype) -> np.ndarray:
    """The tensor's own memory; a copy of one of another type or layout, for which Numba would compile anew."""
    return (tensor if tensor.dtype is dtype else tensor.to(dtype)).contiguous().numpy()


def _as_segments(ends: Tensor) -> np.ndarray:
    """End points [S, 2, 2] as x and y of the start, then of the way to the end: [S, 4], float64."""
    start, end = ends.double().numpy().transpose(1, 0, 2)
    return np.ascontiguousarray(np.hstack([start, end - start]))


def _bounding_circles(segments: np.ndarray) -> np.ndarray:
    """Circles about segments [S, 4]: [3, S]; wider than those by more than any rounding error."""
    start, edge = segments[:, :2], segments[:, 2:]
    radius = np.linalg.norm(edge, axis=1) / 2
    return np.ascontiguousarray(np.vstack([(start + edge / 2).T, radius * (1 + 1e-6) + 1e-6]))


# A division by zero gives inf or nan, as in torch.
_inlined = numba.njit(nogil=True, error_model="numpy")


def _called(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function for calls from Python, or takes it from the cache."""
    try:
        return numba.njit(function, nogil=True, error_model="numpy", cache=True)
    except RuntimeError:  # There is no folder that the cache can be written to.
        return _inlined(function)


@_called
def _sense(world: World, pose: np.ndarray) -> np.ndarray:
    """Ranges [B, R], float32, at poses [B, 3], float32."""
    if pose.shape[1] != 3:
        raise ValueError("a pose has three values")
    cars, rays = len(pose), len(world.fan)
    ranges = np.empty((cars, rays), np.float32)
    found, work = np.empty(len(world.walls), np.int64), np.empty((rays, 3))
    for car in range(cars):
        x, y, heading = np.float64(pose[car, 0]), np.float64(pose[car, 1]), np.float64(pose[car, 2])
        near = _walls_near(world, x, y, world.max_range, found)
        _cast(world, near, x, y, heading, work, ranges[car])
    return ranges


@_called
def _step(
    world: World, pose: np.ndarray, next_gate: np.ndarray, gates_passed: np.ndarray, action: np.ndarray
) -> tuple[np.ndarray, ...]:
    """What `Kernels.step` returns, for a pose in float32 and all else in int64."""
    cars, rays = len(pose), len(world.fan)
    if pose.shape[1] != 3 or len(next_gate) != cars or len(gates_passed) != cars or len(action) != cars:
        raise ValueError("pose, next_gate, gates_passed and action must be of the same number of cars")
    next_pose, ranges = np.empty((cars, 3), np.float32), np.empty((cars, rays), np.float32)
    following, since_start, passed = np.empty(cars, np.int64), np.empty(cars, np.int64), np.empty(cars, np.int64)
    collided = np.empty(cars, np.bool_)
    found, work = np.empty(len(world.walls), np.int64), np.empty((rays, 3))
    for car in range(cars):
        _move(world, pose[car], action[car], next_pose[car])
        begin_x, begin_y = np.float64(pose[car, 0]), np.float64(pose[car, 1])
        x, y, heading = np.float64(next_pose[car, 0]), np.float64(next_pose[car, 1]), np.float64(next_pose[car, 2])
        path_x, path_y = x - begin_x, y - begin_y
        reach = max(world.max_range, math.hypot(path_x, path_y) + world.body_radius)
        near = _walls_near(world, x, y, reach, found)
        collided[car] = _touches(world, near, begin_x, begin_y, path_x, path_y)
        passed[car] = 0 if collided[car] else _count_gates(world, next_gate[car], begin_x, begin_y, path_x, path_y)
        following[car] = (next_gate[car] + passed[car]) % len(world.gates)
        since_start[car] = gates_passed[car] + passed[car]
        _cast(world, near, x, y, heading, work, ranges[car])
    return next_pose, following, since_start, ranges, collided, passed


@_inlined
def _move(world: World, pose: np.ndarray, action: int, moved: np.ndarray) -> None:
    """Writes the pose [3] one step later, in float32 throughout."""
    turn = np.float32(action == _LEFT) - np.float32(action == _RIGHT)
    heading = pose[2] + np.float32(world.yaw_per_step) * turn
    step_length = np.float32(world.step_length)
    moved[0] = pose[0] + step_length * np.float32(math.cos(np.float64(heading)))
    moved[1] = pose[1] + step_length * np.float32(math.sin(np.float64(heading)))
    moved[2] = (heading + np.float32(math.pi)) % np.float32(2 * math.pi) - np.float32(math.pi)


@_inlined
def _walls_near(world: World, x: float, y: float, reach: float, found: np.ndarray) -> np.ndarray:
    """Indices of all the walls that come within `reach` of a point, and of few others, written to the front of `found`.

    To search fewer walls on a long track, change this function only: the others ask for no more than what it promises.
    """
    count = 0
    for wall in range(len(found)):
        dx, dy = world.circles[0, wall] - x, world.circles[1, wall] - y
        far = world.circles[2, wall] + reach
        found[count] = wall
        count += dx * dx + dy * dy <= far * far
    return found[:count]


@_inlined
def _touches(world: World, near: np.ndarray, begin_x: float, begin_y: float, path_x: float, path_y: float) -> bool:
    """Whether the body touches a wall on its straight way."""
    radius = world.body_radius
    end_x, end_y = begin_x + path_x, begin_y + path_y
    middle_x, middle_y = begin_x + path_x / 2, begin_y + path_y / 2
    reach = math.hypot(path_x, path_y) / 2 + radius
    for wall in near:
        dx, dy = world.circles[0, wall] - middle_x, world.circles[1, wall] - middle_y
        far = world.circles[2, wall] + reach
        if dx * dx + dy * dy > far * far:
            continue
        first_x, first_y, edge_x, edge_y = world.walls[wall]
        last_x, last_y = first_x + edge_x, first_y + edge_y
        nearest = min(
            _squared_distance(begin_x, begin_y, first_x, first_y, edge_x, edge_y),
            _squared_distance(end_x, end_y, first_x, first_y, edge_x, edge_y),
            _squared_distance(first_x, first_y, begin_x, begin_y, path_x, path_y),
            _squared_distance(last_x, last_y, begin_x, begin_y, path_x, path_y),
        )
        if nearest < radius * radius:
            return True
        begin_side = edge_x * (begin_y - first_y) - edge_y * (begin_x - first_x)
        end_side = edge_x * (end_y - first_y) - edge_y * (end_x - first_x)
        first_side = path_x * (first_y - begin_y) - path_y * (first_x - begin_x)
        last_side = path_x * (last_y - begin_y) - path_y * (last_x - begin_x)
        if begin_side * end_side < 0 and first_side * last_side < 0:
            return True
    return False


@_inlined
def _squared_distance(x: float, y: float, start_x: float, start_y: float, edge_x: float, edge_y: float) -> float:
    """From a point to a segment, m^2."""
    dx, dy = x - start_x, y - start_y
    share = (dx * edge_x + dy * edge_y) / max(edge_x * edge_x + edge_y * edge_y, _TINY)
    share = min(max(share, 0.0), 1.0)
    dx, dy = dx - share * edge_x, dy - share * edge_y
    return dx * dx + dy * dy


@_inlined
def _count_gates(world: World, next_gate: int, begin_x: float, begin_y: float, path_x: float, path_y: float) -> int:
    """How many gates the straight way crosses forward and in order."""
    passed = 0
    while passed < world.most_gates:
        left_x, left_y, across_x, across_y = world.gates[(next_gate + passed) % len(world.gates)]
        dx, dy = begin_x - left_x, begin_y - left_y
        side_before = across_x * dy - across_y * dx
        side_after = across_x * (dy + path_y) - across_y * (dx + path_x)
        if not (side_before < 0 and side_after >= 0):
            break
        share = side_before / (side_before - side_after)
        dx, dy = dx + share * path_x, dy + share * path_y
        position = (dx * across_x + dy * across_y) / (across_x * across_x + across_y * across_y)
        if not 0 <= position <= 1:
            break
        passed += 1
    return passed


@_inlined
def _cast(
    world: World, near: np.ndarray, x: float, y: float, heading: float, work: np.ndarray, ranges: np.ndarray
) -> None:
    """Writes the distances along the rays, [R], by way of `work`, [R, 3]: the direction and the nearest wall so far."""
    cos, sin = math.cos(heading), math.sin(heading)
    for ray in range(len(work)):
        ray_cos, ray_sin = world.fan[ray]
        work[ray, 0] = cos * ray_cos - sin * ray_sin
        work[ray, 1] = sin * ray_cos + cos * ray_sin
        work[ray, 2] = world.max_range
    for wall in near:
        start_x, start_y, edge_x, edge_y = world.walls[wall]
        dx, dy = start_x - x, start_y - y
        across = dx * edge_y - dy * edge_x
        for ray in range(len(work)):
            ray_x, ray_y, nearest = work[ray]
            scale = 1 / (ray_x * edge_y - ray_y * edge_x)
            distance, position = across * scale, (dx * ray_y - dy * ray_x) * scale
            # No branches, which the processor would guess wrong; inf and nan of a parallel ray fail every comparison.
            meets = (distance >= 0) & (position >= -_JOINT_TOLERANCE) & (position <= 1 + _JOINT_TOLERANCE)
            work[ray, 2] = distance if meets & (distance < nearest) else nearest
    for ray in range(len(work)):
        ranges[ray] = work[ray, 2]
