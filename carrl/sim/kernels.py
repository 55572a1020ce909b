"""The simulator's step and sense as machine code for the CPU, one car at a time.

They compute what `carrl.sim.geometry` and `carrl.sim.simulator` state in torch; tests compare the two. All is float64
and rounded to float32 once. How a car moves is the vehicle model's own, `carrl.sim.vehicle`.

Shapes: `B` cars, `R` rays, `S` entries of a vehicle's state, `C` controls; the others are those of
`carrl.sim.collision_geometry`. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.machine_code import apart, as_array, compiled, dispatched, inlined
from carrl.sim.collision_geometry import CollisionGeometry
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import VehicleModel

# Written out, since Numba's cache sees only changes to this file.
_TINY = np.finfo(np.float64).tiny
_Vector = tuple[float, float]
_Way = tuple[float, float, float, float]
_LANES = 8
"""Rays are computed so many at a time, which is as many numbers as fit into a register of the widest processors."""


class World(NamedTuple):
    """What stays the same from step to step; the arrays are C-contiguous, the first nine those of `CollisionGeometry`.

    Attributes:
        fan, rays: cosines and sines of the rays' angles from the heading, [2, R'], float64, and how many of them count.
        mount: how far ahead of the car's middle they start, m.
        max_range: of the rays, m.
        body_radius, half_length, half_width: of the body that must not touch a wall, m; 0 for what it has not.
        most_gates: how many gates one step can cross at the most.
    """

    walls: np.ndarray
    gates: np.ndarray
    first_gate: np.ndarray
    deck_of_gate: np.ndarray
    corners: np.ndarray
    shapes: np.ndarray
    list_of_cell: np.ndarray
    lists: np.ndarray
    entries: np.ndarray
    fan: np.ndarray
    rays: int
    mount: float
    max_range: float
    body_radius: float
    half_length: float
    half_width: float
    most_gates: int


class Kernels:
    """The compiled step and sense with the constants of one simulator: tensors in, tensors out, on the CPU.

    Args:
        geometry: walls and gates.
        sensor: its rays.
        vehicle: the car.
        most_gates: how many gates one step can cross at the most.
    """

    def __init__(self, geometry: CollisionGeometry, sensor: Sensor, vehicle: VehicleModel, most_gates: int) -> None:
        """Compiles at once, unless that was done before, so that no step takes longer than the others."""
        radius, half_length, half_width = vehicle.body.measures
        self._world = World(
            **{name: np.ascontiguousarray(tensor.numpy()) for name, tensor in geometry._asdict().items()},
            fan=_fan(sensor.angles),
            rays=sensor.rays,
            mount=float(sensor.mount),
            max_range=float(sensor.max_range),
            body_radius=radius,
            half_length=half_length,
            half_width=half_width,
            most_gates=most_gates,
        )
        self._vehicle, self._constants = vehicle, np.array(vehicle.constants, dtype=np.float64)
        self._move = dispatched(vehicle.kernel) if vehicle.kernel else self._move_in_torch
        self._follow = _follow.dispatcher
        no_count = torch.zeros(0, dtype=torch.int64)
        no_state, no_control = (torch.zeros(0, len(names)) for names in (vehicle.state_names, vehicle.control_names))
        self.step(no_state, no_control, no_count, no_count, no_count)
        self.sense(no_state, no_count, no_count)

    def sense(self, state: Tensor, next_gate: Tensor, track: Tensor) -> Tensor:
        """The distances along the rays: states [B, S], gates [B], tracks [B] to [B, R], float32, m."""
        counts = [as_array(count, torch.int64) for count in (next_gate, track)]
        return torch.from_numpy(_sense(self._world, as_array(state, torch.float32), *counts))

    def step(
        self, state: Tensor, control: Tensor, next_gate: Tensor, gates_passed: Tensor, track: Tensor
    ) -> tuple[Tensor, ...]:
        """Moves every car by one time step.

        Returns:
            The state [B, S], next gate [B] and gates passed since the start [B]; then, of this step, the ranges
            [B, R], the collisions [B] and the gates passed [B].
        """
        if len(control) != len(state):
            raise ValueError("state and control must be of the same number of cars")
        before = as_array(state, torch.float32)
        after = self._move(before, as_array(control, torch.float32), self._constants)
        counts = [as_array(count, torch.int64) for count in (next_gate, gates_passed, track)]
        return tuple(map(torch.from_numpy, (after, *self._follow(self._world, before, after, *counts))))

    def follow(self, before: Tensor, after: Tensor, *counts: Tensor) -> tuple[Tensor, ...]:
        """What `step` returns but for the states, which are given; the counts are the same three."""
        states = [as_array(state, torch.float32) for state in (before, after)]
        arrays = [as_array(count, torch.int64) for count in counts]
        return tuple(map(torch.from_numpy, self._follow(self._world, *states, *arrays)))

    def _move_in_torch(self, state: np.ndarray, control: np.ndarray, _: np.ndarray) -> np.ndarray:
        """The step of a vehicle without machine code."""
        return as_array(self._vehicle.step(torch.from_numpy(state), torch.from_numpy(control)), torch.float32)


def _fan(angles: Tensor) -> np.ndarray:
    """Cosines and sines of the angles [R] in double precision, filled up to whole lanes: [2, R']."""
    padded = np.zeros(-(-len(angles) // _LANES) * _LANES)
    padded[: len(angles)] = angles.double().numpy()
    return np.stack([np.cos(padded), np.sin(padded)])


@compiled
def _sense(world: World, state: np.ndarray, next_gate: np.ndarray, track: np.ndarray) -> np.ndarray:
    """Ranges [B, R], float32, of states [B, S], float32."""
    cars = len(state)
    if state.shape[1] < 3 or len(next_gate) != cars or len(track) != cars:
        raise ValueError("state, next_gate and track must be of the same number of cars, a state begin with a pose")
    ranges = np.empty((cars, world.rays), np.float32)
    work = np.empty((3, world.fan.shape[1]))
    for car in range(cars):
        _check_place(world, track[car], next_gate[car])
        x, y, heading = np.float64(state[car, 0]), np.float64(state[car, 1]), np.float64(state[car, 2])
        begin, _, end = _walls_near(world, x, y, _deck(world, track[car], next_gate[car]))
        _cast(world, begin, end, x, y, heading, work, ranges[car])
    return ranges


@compiled
def _follow(
    world: World,
    before: np.ndarray,
    after: np.ndarray,
    next_gate: np.ndarray,
    gates_passed: np.ndarray,
    track: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """What `Kernels.step` returns but for the states, which are given before and after, [B, S], float32."""
    cars = len(before)
    counts = len(after), len(next_gate), len(gates_passed), len(track)
    if before.shape[1] < 3 or after.shape[1] < 3 or counts != (cars, cars, cars, cars):
        raise ValueError("states, next_gate, gates_passed and track must be of the same number of cars")
    ranges = np.empty((cars, world.rays), np.float32)
    following, since_start, passed = np.empty(cars, np.int64), np.empty(cars, np.int64), np.empty(cars, np.int64)
    collided = np.empty(cars, np.bool_)
    work = np.empty((3, world.fan.shape[1]))
    for car in range(cars):
        _check_place(world, track[car], next_gate[car])
        begin_x, begin_y = np.float64(before[car, 0]), np.float64(before[car, 1])
        x, y, heading = np.float64(after[car, 0]), np.float64(after[car, 1]), np.float64(after[car, 2])
        way = begin_x, begin_y, x - begin_x, y - begin_y
        deck = _deck(world, track[car], next_gate[car])
        begin, touching, end = _walls_near(world, x, y, deck)
        # What is no number fails every comparison: such a car would drive on for ever.
        hit = not math.isfinite(x + y)
        if world.half_length > 0:
            hit = hit or _rectangle_touches(world, begin, touching, way, heading)
        else:
            hit = hit or _disc_touches(world, begin, touching, way)
        first = world.first_gate[track[car]]
        gates = world.gates[first : world.first_gate[track[car] + 1]]
        crossed = 0 if hit else _count_gates(gates, world.most_gates, next_gate[car], way)
        collided[car], passed[car], following[car] = hit, crossed, (next_gate[car] + crossed) % len(gates)
        since_start[car] = gates_passed[car] + crossed
        if _deck(world, track[car], following[car]) != deck:
            begin, _, end = _walls_near(world, x, y, _deck(world, track[car], following[car]))
        _cast(world, begin, end, x, y, heading, work, ranges[car])
    return following, since_start, ranges, collided, passed


@inlined
def _check_place(world: World, track: int, next_gate: int) -> None:
    """Raises ValueError where indices would read beyond the arrays, which compiled code does unasked."""
    if not 0 <= track < len(world.first_gate) - 1:
        raise ValueError("a track's index is not one of those that the simulator has")
    if not 0 <= next_gate < world.first_gate[track + 1] - world.first_gate[track]:
        raise ValueError("a gate's index is not one of those that the track has")


@inlined
def _deck(world: World, track: int, next_gate: int) -> int:
    """The deck that a car is on."""
    return world.deck_of_gate[world.first_gate[track] + next_gate]


@inlined
def _walls_near(world: World, x: float, y: float, deck: int) -> tuple[int, int, int]:
    """Where in `entries` the walls near a point begin, where those within touch end, and where all end."""
    corners, shapes = world.corners, world.shapes
    size = corners[deck, 2]
    column, row = math.floor((x - corners[deck, 0]) / size), math.floor((y - corners[deck, 1]) / size)
    number = 0
    if 0 <= column < shapes[deck, 0] and 0 <= row < shapes[deck, 1]:
        number = world.list_of_cell[shapes[deck, 2] + row * shapes[deck, 0] + column]
    return world.lists[number, 0], world.lists[number, 1], world.lists[number, 2]


@inlined
def _disc_touches(world: World, begin: int, end: int, way: _Way) -> bool:
    """Whether the disc touches a wall of these entries on its straight way."""
    radius, (begin_x, begin_y, path_x, path_y) = world.body_radius, way
    end_x, end_y = begin_x + path_x, begin_y + path_y
    for entry in range(begin, end):
        first_x, first_y, last_x, last_y = world.walls[world.entries[entry]]
        edge_x, edge_y = last_x - first_x, last_y - first_y
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


@apart
def _rectangle_touches(world: World, begin: int, end: int, along: _Way, heading: float) -> bool:
    """Whether the rectangle touches a wall of these entries on its straight way: see `geometry.rectangle_touches`."""
    (begin_x, begin_y, path_x, path_y), cos, sin = along, math.cos(heading), math.sin(heading)
    way = cos * path_x + sin * path_y, cos * path_y - sin * path_x  # in the frame of the rectangle
    reach_x = abs(cos) * world.half_length + abs(sin) * world.half_width
    reach_y = abs(sin) * world.half_length + abs(cos) * world.half_width
    low_x, high_x = begin_x + min(path_x, 0.0) - reach_x, begin_x + max(path_x, 0.0) + reach_x
    low_y, high_y = begin_y + min(path_y, 0.0) - reach_y, begin_y + max(path_y, 0.0) + reach_y
    for entry in range(begin, end):
        first_x, first_y, last_x, last_y = world.walls[world.entries[entry]]
        beside = max(first_x, last_x) <= low_x or min(first_x, last_x) >= high_x
        if beside or max(first_y, last_y) <= low_y or min(first_y, last_y) >= high_y:
            continue  # as of most walls
        first_x, first_y, last_x, last_y = first_x - begin_x, first_y - begin_y, last_x - begin_x, last_y - begin_y
        first = cos * first_x + sin * first_y, cos * first_y - sin * first_x
        last = cos * last_x + sin * last_y, cos * last_y - sin * last_x
        if not (
            _separates(world, (1.0, 0.0), first, last, way)
            or _separates(world, (0.0, 1.0), first, last, way)
            or _separates(world, (first[1] - last[1], last[0] - first[0]), first, last, way)
            or _separates(world, (-way[1], way[0]), first, last, way)
        ):
            return True
    return False


@inlined
def _separates(world: World, axis: _Vector, first: _Vector, last: _Vector, way: _Vector) -> bool:
    """Whether the rectangle about the origin and the wall moved back along the way lie apart along an axis."""
    reach = world.half_length * abs(axis[0]) + world.half_width * abs(axis[1])
    begin, end = axis[0] * first[0] + axis[1] * first[1], axis[0] * last[0] + axis[1] * last[1]
    along = axis[0] * way[0] + axis[1] * way[1]
    low, high = min(begin, end) - max(along, 0.0), max(begin, end) - min(along, 0.0)
    return reach > 0 and (low >= reach or high <= -reach)


@inlined
def _squared_distance(x: float, y: float, start_x: float, start_y: float, edge_x: float, edge_y: float) -> float:
    """From a point to a segment, m^2."""
    dx, dy = x - start_x, y - start_y
    share = (dx * edge_x + dy * edge_y) / max(edge_x * edge_x + edge_y * edge_y, _TINY)
    share = min(max(share, 0.0), 1.0)
    dx, dy = dx - share * edge_x, dy - share * edge_y
    return dx * dx + dy * dy


@inlined
def _count_gates(gates: np.ndarray, most: int, next_gate: int, way: _Way) -> int:
    """How many of a track's gates [G, 4] the straight way crosses forward and in order."""
    passed, (begin_x, begin_y, path_x, path_y) = 0, way
    while passed < most:
        left_x, left_y, right_x, right_y = gates[(next_gate + passed) % len(gates)]
        across_x, across_y = right_x - left_x, right_y - left_y
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


@inlined
def _cast(
    world: World, begin: int, end: int, x: float, y: float, heading: float, work: np.ndarray, ranges: np.ndarray
) -> None:
    """Writes the distances along the rays to the walls of these entries, [R].

    `work`, [3, R'], holds each ray's direction, and 1 / distance of the nearest wall so far: so one division for each
    wall serves all rays. A ray meets a wall whose ends lie to either side of it. Walls that share an end compute the
    same side for it, so nothing slips through a joint. Nan, where a wall points at the car, fails every comparison.
    Two walls at a time, since the processor waits for what the last ones wrote.
    """
    cos, sin = math.cos(heading), math.sin(heading)
    x, y = x + world.mount * cos, y + world.mount * sin
    walls, entries, fan_x, fan_y = world.walls, world.entries, world.fan[0], world.fan[1]
    ray_x, ray_y, nearness = work[0], work[1], work[2]
    for ray in range(len(nearness)):
        ray_x[ray] = cos * fan_x[ray] - sin * fan_y[ray]
        ray_y[ray] = sin * fan_x[ray] + cos * fan_y[ray]
        nearness[ray] = 1 / world.max_range
    for entry in range(begin, end, 2):
        a, b = entries[entry], entries[entry + 1]
        a_x, a_y, a_end_x, a_end_y = walls[a, 0] - x, walls[a, 1] - y, walls[a, 2] - x, walls[a, 3] - y
        b_x, b_y, b_end_x, b_end_y = walls[b, 0] - x, walls[b, 1] - y, walls[b, 2] - x, walls[b, 3] - y
        a_scale = 1 / (a_x * (a_end_y - a_y) - a_y * (a_end_x - a_x))
        b_scale = 1 / (b_x * (b_end_y - b_y) - b_y * (b_end_x - b_x))
        for ray in range(len(nearness)):
            a_side, a_end_side = a_x * ray_y[ray] - a_y * ray_x[ray], a_end_x * ray_y[ray] - a_end_y * ray_x[ray]
            b_side, b_end_side = b_x * ray_y[ray] - b_y * ray_x[ray], b_end_x * ray_y[ray] - b_end_y * ray_x[ray]
            to_a = (a_side - a_end_side) * a_scale if a_side * a_end_side <= 0 else 0.0
            to_b = (b_side - b_end_side) * b_scale if b_side * b_end_side <= 0 else 0.0
            nearest = nearness[ray]
            nearest = to_a if to_a > nearest else nearest
            nearness[ray] = to_b if to_b > nearest else nearest
        if not math.isfinite(a_scale + b_scale):
            _cast_in_line(a_scale, a_x, a_y, a_end_x, a_end_y, work)
            _cast_in_line(b_scale, b_x, b_y, b_end_x, b_end_y, work)
    for ray in range(len(ranges)):
        ranges[ray] = 1 / nearness[ray]


@inlined
def _cast_in_line(scale: float, x: float, y: float, end_x: float, end_y: float, work: np.ndarray) -> None:
    """Zero distance for rays that begin on this wall: `scale` is infinite where the car is in line with it."""
    if not math.isfinite(scale):
        for ray in range(work.shape[1]):
            side, end_side = x * work[1, ray] - y * work[0, ray], end_x * work[1, ray] - end_y * work[0, ray]
            if side * end_side <= 0 and side != end_side:
                work[2, ray] = np.inf
