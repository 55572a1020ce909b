"""What becomes of cars that touch a wall where that does not end their episode: they go on along it.

The simulator calls this for the few cars that have touched one in a step.

Shapes: `K` cars, `S` entries of a vehicle's state, `W` walls near each car. Lengths are in metres, angles in radians
counter-clockwise from +x.
"""

import math

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.machine_code import apart, as_array, compiled, inlined
from carrl.sim.vehicle import Disc, Rectangle, VehicleModel

_GAP = 0.02
"""How far from the wall a car is put, m; more than float32 rounds by on any circuit."""
_SQUARE = -0.05
"""Cosine of an angle that is a little more than a right one: a car that meets a wall so does not turn round."""
_ROUNDS, _HALVINGS = 8, 24
_Body = tuple[float, float, float]


def slide(before: Tensor, after: Tensor, walls: Tensor, body: Disc | Rectangle) -> tuple[Tensor, Tensor]:
    """Where the walls leave cars that have touched one in a step, and which way it leads them on.

    A car is turned along the wall that it touches first, drives the rest of its way along it, and is free of all walls
    then; where there is no room for that, it stays where it touched, so turned or as it is; where there is none for
    that either, where it was before the step.

    Args:
        before: states before the step, [K, S], float32, free of walls.
        after: as if there were no wall, [K, S], float32.
        walls: near each car, [K, W, 2, 2], float64, m.
        body: that must not touch them.

    Returns:
        The poses, [K, 3], float32, and the direction along the wall that is nearer to the heading, [K], float32, rad;
        if neither is, the one in which the wall is drawn, which is the driving direction.
    """
    radius, half_length, half_width = body.measures
    states = (as_array(state.cpu(), torch.float32) for state in (before, after))
    near = as_array(walls.cpu().flatten(-2), torch.float64)
    pose, direction = _slide(*states, near, (radius, half_length, half_width))
    return torch.from_numpy(pose).to(after.device), torch.from_numpy(direction).to(after.device)


def compile_slide(vehicle: VehicleModel) -> None:
    """Compiles at once, unless that was done before, so that no step takes longer than the others.

    Raises:
        ConfigError: the vehicle's corners alone touch walls.
    """
    if vehicle.body.by_corners:
        raise ConfigError("vehicle.contact is 'corners'; where end lets cars slide along walls it must be 'body'")
    nothing = torch.zeros(0, len(vehicle.state_names))
    slide(nothing, nothing, torch.zeros(0, 1, 2, 2, dtype=torch.float64), vehicle.body)


@compiled
def _slide(before: np.ndarray, after: np.ndarray, walls: np.ndarray, body: _Body) -> tuple[np.ndarray, np.ndarray]:
    """What `slide` returns."""
    cars = len(before)
    if len(after) != cars or len(walls) != cars or before.shape[1] < 3 or after.shape[1] < 3:
        raise ValueError("states and walls must be of the same number of cars, a state begin with a pose")
    pose, direction = before[:, :3].copy(), before[:, 2].copy()
    wide = body[0] + _GAP if body[0] > 0 else 0.0, body[1] + _GAP, body[2] + _GAP
    for car in range(cars):
        x, y, heading = np.float64(before[car, 0]), np.float64(before[car, 1]), np.float64(after[car, 2])
        way_x, way_y = after[car, 0] - x, after[car, 1] - y
        if not math.isfinite(way_x + way_y + heading):
            continue
        near = _near(walls[car], x, y, math.hypot(way_x, way_y) + 2 * (wide[0] + wide[1] + wide[2]))
        low, touched = _first_touch(near, x, y, way_x, way_y, heading, body)
        if touched < 0:
            continue
        along = math.atan2(near[touched, 3] - near[touched, 1], near[touched, 2] - near[touched, 0])
        if math.cos(along - heading) < _SQUARE:
            along += math.pi
        direction[car] = (along + math.pi) % (2 * math.pi) - math.pi
        touch_x, touch_y = x + low * way_x, y + low * way_y
        rest = (1 - low) * max(way_x * math.cos(along) + way_y * math.sin(along), 0.0)
        for turned, further in ((along, rest), (along, 0.0), (heading, 0.0)):
            there_x, there_y = touch_x + further * math.cos(along), touch_y + further * math.sin(along)
            free_x, free_y, is_free = _settle(near, touch_x, touch_y, there_x, there_y, turned, wide)
            if is_free:
                pose[car, 0], pose[car, 1] = free_x, free_y
                pose[car, 2] = (turned + math.pi) % (2 * math.pi) - math.pi
                break
    return pose, direction


@inlined
def _near(walls: np.ndarray, x: float, y: float, reach: float) -> np.ndarray:
    """Those of the walls [W, 4] that are within reach of a point."""
    near, count = np.empty_like(walls), 0
    for wall in range(len(walls)):
        if _distance(walls[wall], x, y)[0] <= reach:
            near[count], count = walls[wall], count + 1
    return near[:count]


@inlined
def _first_touch(
    near: np.ndarray, x: float, y: float, way_x: float, way_y: float, heading: float, body: _Body
) -> tuple[float, int]:
    """The share of the way after which the body touches a wall, and the wall; -1 if it does not.

    It is found by halving, on the side where nothing is touched; 0 where the body touches a wall as soon as it turns.
    """
    if _touched(near, x, y, 0.0, 0.0, heading, body) >= 0:
        return 0.0, _touched(near, x, y, 0.0, 0.0, heading, body)
    touched = _touched(near, x, y, way_x, way_y, heading, body)
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS if touched >= 0 else 0):
        middle = (low + high) / 2
        wall = _touched(near, x, y, middle * way_x, middle * way_y, heading, body)
        if wall >= 0:
            touched, high = wall, middle
        else:
            low = middle
    return low, touched


@apart
def _touched(near: np.ndarray, x: float, y: float, way_x: float, way_y: float, heading: float, body: _Body) -> int:
    """A wall that the body touches on its straight way, or -1: see `geometry.path_clearance`, `rectangle_touches`."""
    cos, sin = math.cos(heading), math.sin(heading)
    end_x, end_y = x + way_x, y + way_y
    for wall in range(len(near)):
        first_x, first_y, last_x, last_y = near[wall, 0], near[wall, 1], near[wall, 2], near[wall, 3]
        if body[0] > 0:
            way = np.array([x, y, end_x, end_y])
            clearance = min(
                min(_distance(near[wall], x, y)[0], _distance(near[wall], end_x, end_y)[0]),
                min(_distance(way, first_x, first_y)[0], _distance(way, last_x, last_y)[0]),
            )
            if clearance < body[0] or _crosses(near[wall], x, y, end_x, end_y):
                return wall
            continue
        separates = False
        for axis_x, axis_y in ((cos, sin), (-sin, cos), (first_y - last_y, last_x - first_x), (-way_y, way_x)):
            reach = body[1] * abs(cos * axis_x + sin * axis_y) + body[2] * abs(cos * axis_y - sin * axis_x)
            begin = (first_x - x) * axis_x + (first_y - y) * axis_y
            end = (last_x - x) * axis_x + (last_y - y) * axis_y
            along = way_x * axis_x + way_y * axis_y
            low, high = min(begin, end) - max(along, 0.0), max(begin, end) - min(along, 0.0)
            separates = separates or (reach > 0 and (low >= reach or high <= -reach))
        if not separates:
            return wall
    return -1


@apart
def _settle(
    near: np.ndarray, begin_x: float, begin_y: float, x: float, y: float, heading: float, body: _Body
) -> tuple[float, float, bool]:
    """The body pushed out of the walls, out of each the shortest way, and whether it is free on this side of them."""
    cos, sin = math.cos(heading), math.sin(heading)
    for _ in range(_ROUNDS):
        is_free = True
        for wall in range(len(near)):
            push_x, push_y = _push(near[wall], x, y, cos, sin, body)
            if push_x != 0 or push_y != 0:
                x, y, is_free = x + push_x, y + push_y, False
        if is_free:
            break
    for wall in range(len(near)):
        is_free = is_free and not _crosses(near[wall], begin_x, begin_y, x, y)
    return x, y, is_free


@inlined
def _push(wall: np.ndarray, x: float, y: float, cos: float, sin: float, body: _Body) -> tuple[float, float]:
    """The shortest way by which the body comes free of a wall; 0, 0 where it is."""
    first_x, first_y, last_x, last_y = wall[0] - x, wall[1] - y, wall[2] - x, wall[3] - y
    edge_x, edge_y = last_x - first_x, last_y - first_y
    length = max(math.hypot(edge_x, edge_y), 1e-9)
    if body[0] > 0:
        distance, away_x, away_y = _distance(wall, x, y)
        if distance >= body[0]:
            return 0.0, 0.0
        if distance == 0:
            return -edge_y / length * body[0], edge_x / length * body[0]
        return away_x / distance * (body[0] - distance + 1e-9), away_y / distance * (body[0] - distance + 1e-9)
    least, push_x, push_y = np.inf, 0.0, 0.0
    for axis_x, axis_y in ((cos, sin), (-sin, cos), (-edge_y / length, edge_x / length)):
        reach = body[1] * abs(cos * axis_x + sin * axis_y) + body[2] * abs(cos * axis_y - sin * axis_x)
        begin, end = first_x * axis_x + first_y * axis_y, last_x * axis_x + last_y * axis_y
        forth, back = max(begin, end) + reach, reach - min(begin, end)
        if min(forth, back) <= 0:
            return 0.0, 0.0
        if min(forth, back) < least and (axis_x != 0 or axis_y != 0):
            least = min(forth, back)
            sign = (least + 1e-9) * (1.0 if forth < back else -1.0)
            push_x, push_y = sign * axis_x, sign * axis_y
    return push_x, push_y


@inlined
def _distance(wall: np.ndarray, x: float, y: float) -> tuple[float, float, float]:
    """From a wall to a point: how far, and x and y of the way there."""
    edge_x, edge_y = wall[2] - wall[0], wall[3] - wall[1]
    away_x, away_y = x - wall[0], y - wall[1]
    share = (away_x * edge_x + away_y * edge_y) / max(edge_x * edge_x + edge_y * edge_y, 1e-300)
    share = min(max(share, 0.0), 1.0)
    away_x, away_y = away_x - share * edge_x, away_y - share * edge_y
    return math.hypot(away_x, away_y), away_x, away_y


@inlined
def _crosses(wall: np.ndarray, begin_x: float, begin_y: float, end_x: float, end_y: float) -> bool:
    """Whether a straight way leads through a wall."""
    edge_x, edge_y, way_x, way_y = wall[2] - wall[0], wall[3] - wall[1], end_x - begin_x, end_y - begin_y
    begin_side = edge_x * (begin_y - wall[1]) - edge_y * (begin_x - wall[0])
    end_side = edge_x * (end_y - wall[1]) - edge_y * (end_x - wall[0])
    first_side = way_x * (wall[1] - begin_y) - way_y * (wall[0] - begin_x)
    last_side = way_x * (wall[3] - begin_y) - way_y * (wall[2] - begin_x)
    return begin_side * end_side < 0 and first_side * last_side < 0
