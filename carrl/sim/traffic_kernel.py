"""Cars that share a world as machine code for the CPU: what their rays see of each other, and where they touch.

All is float64 and rounded to float32 once. Consecutive rows share a world.

Shapes: `W` worlds, `K` cars of each, `L` of them, the first ones, that look; `B` = W * K rows, `R` rays, `S` entries of
a vehicle's state. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from typing import NamedTuple

import numpy as np

from carrl.machine_code import apart, compiled, inlined

# Written out, since Numba's cache sees only changes to this file.
_GAP = 0.01
"""So far from each other cars stop that would touch, m; more than float32 rounds by on any circuit."""
_PARALLEL = 0.05
"""Sine of an angle up to which a side that is touched is touched along its length, not by a corner."""
_UNKNOWN = 2.0
"""In place of a cosine."""
_FRONT, _REAR, _LEFT, _RIGHT = 1, 2, 3, 4
_Touch = tuple[float, float, float, int, float]


class Outline(NamedTuple):
    """What stays the same from step to step.

    Attributes:
        half_length, half_width: of the rectangle that other cars see and touch, m.
        fan: cosines and sines of the rays' angles from the heading, [2, R'], float64.
        rays: how many of them count.
        mount: how far ahead of the car's middle they start, m.
        max_range: of the rays, m.
        looks_ahead: whether no ray points backwards.
    """

    half_length: float
    half_width: float
    fan: np.ndarray
    rays: int
    mount: float
    max_range: float
    looks_ahead: bool


@compiled
def see(
    outline: Outline, state: np.ndarray, cars: int, looking: int, walls: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the rays of the first cars of each world meet.

    Args:
        outline: of every car.
        state: [W * K, S], float32.
        cars: K.
        looking: L, from 1 to K.
        walls: distances along the rays to the walls, [W * L, R], float32.

    Returns:
        The distances to a wall or another car, whichever is nearer, [W * L, R], float32; 0 for rays that begin in a
        car; and whether it is a car, [W * L, R], bool.
    """
    worlds = len(state) // max(cars, 1)
    if state.shape[1] < 3 or not 1 <= looking <= cars or len(state) != worlds * cars:
        raise ValueError("states must be of whole worlds, a state begin with a pose")
    if walls.shape != (worlds * looking, outline.rays):
        raise ValueError("there must be a distance for each ray of each car that looks")
    ranges, on_car = walls.copy(), np.zeros(walls.shape, np.bool_)
    work, directions = np.empty((3, outline.fan.shape[1])), np.empty((2, cars))
    half_length, half_width, mount = outline.half_length, outline.half_width, outline.mount
    reach = math.sqrt(half_length**2 + half_width**2)
    sight = (outline.max_range + reach + abs(mount)) ** 2
    for world in range(worlds):
        first = world * cars
        for car in range(cars):
            directions[0, car] = _UNKNOWN
        for own in range(looking):
            row, is_ready = world * looking + own, False
            x, y = np.float64(state[first + own, 0]), np.float64(state[first + own, 1])
            for other in range(cars):
                dx, dy = state[first + other, 0] - x, state[first + other, 1] - y
                if not dx * dx + dy * dy < sight or other == own:
                    continue
                cos, sin = _direction(state, first, own, directions)
                dx, dy = dx - mount * cos, dy - mount * sin
                if outline.looks_ahead and cos * dx + sin * dy < -reach:
                    continue
                if not is_ready:
                    _begin(outline, cos, sin, work)
                    is_ready = True
                other_cos, other_sin = _direction(state, first, other, directions)
                _cast(dx, dy, other_cos, other_sin, half_length, half_width, work)
            if is_ready:
                _finish(ranges[row], on_car[row], work)
    return ranges, on_car


@inlined
def _direction(state: np.ndarray, first: int, car: int, directions: np.ndarray) -> tuple[float, float]:
    """Cosine and sine of a car's heading, which are computed once: of the world that begins in this row, [2, K]."""
    if directions[0, car] == _UNKNOWN:
        heading = np.float64(state[first + car, 2])
        directions[0, car], directions[1, car] = math.cos(heading), math.sin(heading)
    return directions[0, car], directions[1, car]


@inlined
def _begin(outline: Outline, cos: float, sin: float, work: np.ndarray) -> None:
    """Writes each ray's direction into `work`, [3, R'], and 1 / distance of the nearest car so far: there is none."""
    fan_x, fan_y, ray_x, ray_y, nearness = outline.fan[0], outline.fan[1], work[0], work[1], work[2]
    for ray in range(len(nearness)):
        ray_x[ray] = cos * fan_x[ray] - sin * fan_y[ray]
        ray_y[ray] = sin * fan_x[ray] + cos * fan_y[ray]
        nearness[ray] = 0.0


@apart
def _cast(x: float, y: float, cos: float, sin: float, half_length: float, half_width: float, work: np.ndarray) -> None:
    """Brings rays up to the car whose middle is here, seen from where they begin, with this direction.

    Of its four sides only those count that face the rays' origin, one of each pair at most: as in `carrl.sim.kernels`,
    one division for each serves all rays. If none does, the origin is inside.
    """
    ray_x, ray_y, nearness = work[0], work[1], work[2]
    ahead, left = -(cos * x + sin * y), sin * x - cos * y  # of the origin, as the car sees it
    if abs(ahead) <= half_length and abs(left) <= half_width:
        nearness[:] = np.inf
        return
    for pair in range(2):
        own, half, width = (ahead, half_length, half_width) if pair == 0 else (left, half_width, half_length)
        if abs(own) <= half:
            continue
        out = math.copysign(half, own)
        if pair == 0:
            middle_x, middle_y, along_x, along_y = x + out * cos, y + out * sin, -width * sin, width * cos
        else:
            middle_x, middle_y, along_x, along_y = x - out * sin, y + out * cos, width * cos, width * sin
        begin_x, begin_y = middle_x - along_x, middle_y - along_y
        end_x, end_y = middle_x + along_x, middle_y + along_y
        scale = 1 / (begin_x * end_y - begin_y * end_x)
        for ray in range(len(nearness)):
            begin = begin_x * ray_y[ray] - begin_y * ray_x[ray]
            end = end_x * ray_y[ray] - end_y * ray_x[ray]
            near = (begin - end) * scale if begin * end <= 0 else 0.0
            nearest = nearness[ray]
            nearness[ray] = near if near > nearest else nearest


@inlined
def _finish(ranges: np.ndarray, on_car: np.ndarray, work: np.ndarray) -> None:
    """Writes the distances of those rays that a car is nearer to than their walls, [R]."""
    for ray in range(len(ranges)):
        if work[2, ray] * ranges[ray] > 1:
            ranges[ray], on_car[ray] = 1 / work[2, ray], True


@compiled
def meet(outline: Outline, before: np.ndarray, after: np.ndarray, cars: int) -> tuple[np.ndarray, ...]:
    """Where the cars of each world touch each other as they drive one step, all at the same time.

    Each turns first, on the spot, and then drives its straight way at an even speed, as when it meets walls: nothing is
    jumped over, however fast. A car that would drive into another one stops `_GAP` before it, and stays there until the
    step is over. Cars that would touch by turning alone do not turn. So cars that do not overlap never do. One whose
    pose is no number touches nothing.

    Args:
        outline: of every car.
        before: states before the step, [W * K, S], float32.
        after: the states as if each were alone, [W * K, S], float32.
        cars: K.

    Returns:
        Of each car [W * K]: its state after the step, [W * K, S], float32, which is as if it were alone but for the
        pose where it is stopped; the share of its way that it drove, float32;
        which car of its world it touched first, int64, -1 for none; with which part, int64, see `carrl.sim.traffic`;
        whether that was driving with the front into the other; and how fast they came together, float32, m a step.
    """
    rows = len(before)
    if before.shape[1] < 3 or after.shape[1] < 3 or len(after) != rows or rows % max(cars, 1) or cars < 1:
        raise ValueError("states must be of whole worlds, a state begin with a pose")
    pose, share = after.copy(), np.ones(rows, np.float32)
    other, part = np.full(rows, -1), np.zeros(rows, np.int64)
    at_fault, closing = np.zeros(rows, np.bool_), np.zeros(rows, np.float32)
    for first in range(0, rows, cars):
        last = first + cars
        if _may_meet(outline, before[first:last], after[first:last]):
            _drive_together(
                outline,
                before[first:last],
                after[first:last],
                pose[first:last],
                share[first:last],
                other[first:last],
                part[first:last],
                at_fault[first:last],
                closing[first:last],
            )
    return pose, share, other, part, at_fault, closing


@inlined
def _may_meet(outline: Outline, before: np.ndarray, after: np.ndarray) -> bool:
    """Whether any two of the cars [K] come so near that they might touch."""
    reach = 2 * math.sqrt(outline.half_length**2 + outline.half_width**2)
    for car in range(len(before)):
        x, y = np.float64(before[car, 0]), np.float64(before[car, 1])
        way_x, way_y = after[car, 0] - x, after[car, 1] - y
        for other in range(car):
            dx, dy = before[other, 0] - x, before[other, 1] - y
            turn_x = after[other, 0] - np.float64(before[other, 0]) - way_x
            turn_y = after[other, 1] - np.float64(before[other, 1]) - way_y
            if math.sqrt(dx * dx + dy * dy) < reach + math.sqrt(turn_x * turn_x + turn_y * turn_y):
                return True
    return False


@apart
def _drive_together(
    outline: Outline,
    before: np.ndarray,
    after: np.ndarray,
    pose: np.ndarray,
    share: np.ndarray,
    other: np.ndarray,
    part: np.ndarray,
    at_fault: np.ndarray,
    closing: np.ndarray,
) -> None:
    """What `meet` does in one world, from one touch to the next."""
    cars = len(before)
    place, way = before[:, :2].astype(np.float64), np.zeros((cars, 2))
    axes, drives, turns = np.empty((cars, 2)), np.zeros(cars, np.bool_), np.zeros(cars, np.bool_)
    for car in range(cars):
        heading = np.float64(after[car, 2])
        axes[car] = math.cos(heading), math.sin(heading)
        drives[car] = math.isfinite(after[car, 0] + after[car, 1] + heading + before[car, 0] + before[car, 1])
        turns[car] = drives[car] and after[car, 2] != before[car, 2]
        if drives[car]:
            way[car] = after[car, :2] - place[car]
    is_somewhere = drives.copy()
    for _ in range(cars):
        is_settled = True
        for one in range(cars):
            for two in range(one):
                if not (turns[one] or turns[two]) or not (is_somewhere[one] and is_somewhere[two]):
                    continue
                touch = _touch(outline, place, way, axes, one, two)
                if touch[4] <= 0:
                    continue
                _note(outline, place, way, axes, one, two, touch, other, part, at_fault, closing)
                for car in (one, two):
                    heading = np.float64(before[car, 2])
                    axes[car] = math.cos(heading), math.sin(heading)
                    if turns[car]:
                        pose[car, 2] = before[car, 2]
                    turns[car] = False
                is_settled = False
        if is_settled:
            break
    now = 0.0
    for _ in range(cars + 1):
        left, one, two = 1 - now, -1, -1
        touch = (np.inf, 0.0, 0.0, 0, 0.0)
        for car in range(cars):
            for mate in range(car):
                if not (drives[car] or drives[mate]) or not (is_somewhere[car] and is_somewhere[mate]):
                    continue
                found = _touch(outline, place, way, axes, car, mate)
                if found[0] < min(touch[0], left):
                    touch, one, two = found, car, mate
        if one < 0:
            break
        speed = (way[one, 0] - way[two, 0]) * touch[1] + (way[one, 1] - way[two, 1]) * touch[2]
        drive = max(touch[0] - _GAP / max(speed, 1e-12), 0.0)
        for car in range(cars):
            place[car] += drive * way[car]
        now += drive
        _note(outline, place, way, axes, one, two, touch, other, part, at_fault, closing)
        for car, sign in ((one, 1.0), (two, -1.0)):
            if drives[car] and sign * (way[car, 0] * touch[1] + way[car, 1] * touch[2]) > 0:
                drives[car], share[car] = False, now
                way[car] = 0.0
                pose[car, 0], pose[car, 1] = place[car]


@apart
def _touch(outline: Outline, place: np.ndarray, way: np.ndarray, axes: np.ndarray, one: int, two: int) -> _Touch:
    """When the first car touches the second, on the way that is left of the step.

    Of two rectangles that move, the time in which they overlap along an axis is an interval, and they overlap while
    they do so along all four axes of both.

    Source: Gottschalk, Lin and Manocha 1996, "OBBTree", the separating axis theorem.

    Returns:
        After which share of the way, infinite if not; the direction from one to the other that parts them then, x and
        y; the axis, 0 and 1 of the first car, 2 and 3 of the second; and how deep they overlap now, m, if more than 0.
    """
    dx, dy = place[two, 0] - place[one, 0], place[two, 1] - place[one, 1]
    way_x, way_y = way[two, 0] - way[one, 0], way[two, 1] - way[one, 1]
    enter, leave, normal_x, normal_y, axis = -np.inf, np.inf, 0.0, 0.0, 0
    depth, depth_x, depth_y, depth_axis = np.inf, 0.0, 0.0, 0
    misses = False
    for number in range(4):
        cos, sin = axes[one if number < 2 else two]
        across_x, across_y = (cos, sin) if number % 2 == 0 else (-sin, cos)
        reach = 0.0
        for car in (one, two):
            cos, sin = axes[car]
            reach += outline.half_length * abs(cos * across_x + sin * across_y)
            reach += outline.half_width * abs(cos * across_y - sin * across_x)
        apart_by, moved = dx * across_x + dy * across_y, way_x * across_x + way_y * across_y
        if reach - abs(apart_by) < depth:
            sign = 1.0 if apart_by >= 0 else -1.0
            depth, depth_x, depth_y, depth_axis = reach - abs(apart_by), sign * across_x, sign * across_y, number
        if moved == 0:
            misses = misses or abs(apart_by) >= reach
            continue
        begin, end = (-reach - apart_by) / moved, (reach - apart_by) / moved
        if moved < 0:
            begin, end = end, begin
        if begin > enter:
            sign = 1.0 if moved < 0 else -1.0
            enter, normal_x, normal_y, axis = begin, sign * across_x, sign * across_y, number
        leave = min(leave, end)
    if depth > 0:
        comes_nearer = way_x * depth_x + way_y * depth_y < 0
        return (0.0 if comes_nearer else np.inf), depth_x, depth_y, depth_axis, depth
    if misses or not enter < leave or leave <= 0:
        return np.inf, 0.0, 0.0, 0, depth
    return max(enter, 0.0), normal_x, normal_y, axis, depth


@apart
def _note(
    outline: Outline,
    place: np.ndarray,
    way: np.ndarray,
    axes: np.ndarray,
    one: int,
    two: int,
    touch: _Touch,
    other: np.ndarray,
    part: np.ndarray,
    at_fault: np.ndarray,
    closing: np.ndarray,
) -> None:
    """Writes down who touches whom, for those that have touched nobody in this step yet.

    The point where they touch is the one of the car without the axis that reaches furthest towards the other one.
    """
    normal_x, normal_y = touch[1], touch[2]
    corner_of, sign = (two, -1.0) if touch[3] < 2 else (one, 1.0)
    cos, sin = axes[corner_of]
    ahead, aside = sign * (cos * normal_x + sin * normal_y), sign * (cos * normal_y - sin * normal_x)
    ahead = 0.0 if abs(ahead) < _PARALLEL else math.copysign(outline.half_length, ahead)
    aside = 0.0 if abs(aside) < _PARALLEL else math.copysign(outline.half_width, aside)
    x, y = place[corner_of, 0] + cos * ahead - sin * aside, place[corner_of, 1] + sin * ahead + cos * aside
    speed = (way[one, 0] - way[two, 0]) * normal_x + (way[one, 1] - way[two, 1]) * normal_y
    for car, mate, sign in ((one, two, 1.0), (two, one, -1.0)):
        if other[car] >= 0:
            continue
        cos, sin = axes[car]
        ahead = ((x - place[car, 0]) * cos + (y - place[car, 1]) * sin) / outline.half_length
        aside = ((y - place[car, 1]) * cos - (x - place[car, 0]) * sin) / outline.half_width
        if abs(ahead) >= abs(aside) - 1e-9:
            part[car] = _FRONT if ahead > 0 else _REAR
        else:
            part[car] = _LEFT if aside > 0 else _RIGHT
        drives_into = sign * (way[car, 0] * normal_x + way[car, 1] * normal_y) > 0
        other[car], closing[car] = mate, max(speed, 0.0)
        at_fault[car] = part[car] == _FRONT and drives_into
