"""The step of `carrl.opponents.line` as machine code, one opponent at a time.

Shapes: `B` worlds, `M` opponents of each, `S` entries of a vehicle's state, `P` places along all tracks. Units: m,
s, rad.
"""

import math
from typing import NamedTuple

import numpy as np

from carrl.machine_code import compiled, inlined
from carrl.sim.places import Roads


class Lane(NamedTuple):
    """What stays the same from step to step.

    Attributes:
        speeds: that are possible at evenly spaced places of each track, [P], m/s.
        offsets: from the centreline to the line that is followed at these places, [P], m, left positive.
        first: place of each track, and at the end P, [T + 1], int64.
        time_step: s.
        length, width: of a car, m.
        edge: how far lanes stay away from the walls, m.
        drive, brakes: strongest accelerations, m/s^2.
        headway: from the car ahead, s.
        standstill: the same at rest, m.
        columns: of speed, yaw rate and both accelerations in a state, -1 for those that it has not, [4].
    """

    speeds: np.ndarray
    offsets: np.ndarray
    first: np.ndarray
    time_step: float
    length: float
    width: float
    edge: float
    drive: float
    brakes: float
    headway: float
    standstill: float
    columns: np.ndarray


@compiled
def follow_lanes(
    lane: Lane,
    roads: Roads,
    state: np.ndarray,
    station: np.ndarray,
    pace: np.ndarray,
    side: np.ndarray,
    track: np.ndarray,
    cars: np.ndarray,
    moves: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """States [B, M, S] and stations [B, M] one step later, both float32; without a move those of being there.

    Args:
        lane: what stays the same.
        roads: of all tracks.
        state: of the opponents, [B, M, S].
        station: [B, M].
        pace: share of the possible speed, [B, M].
        side: of the road, from -1 to 1, [B, M].
        track: of each world, [B].
        cars: states of those that are no opponents, [B, S].
        moves: whether a step is made.
    """
    worlds, count, size = state.shape
    if len(track) != worlds or len(cars) != worlds or station.shape != (worlds, count) or cars.shape[1] != size:
        raise ValueError("states, stations and tracks must be of the same number of cars")
    after, reached = np.zeros_like(state), np.empty_like(station)
    for world in range(worlds):
        own = track[world]
        if not 0 <= own < len(roads.lengths):
            raise ValueError("a track's index is not one of those that the simulator has")
        length = roads.lengths[own]
        places = lane.first[own + 1] - lane.first[own]
        for number in range(count):
            here = np.float64(station[world, number])
            place = lane.first[own] + min(int(here / length * places), places - 1)
            possible = pace[world, number] * lane.speeds[place]
            speed = possible
            if not moves and lane.columns[0] >= 0:
                speed = min(speed, np.float64(state[world, number, lane.columns[0]]))
            if moves:
                speed = _speed(lane, state[world], number, cars[world], possible)
                here += speed * lane.time_step * _pose(lane, roads, own, here, side[world, number])[3]
                here -= length * math.floor(here / length)
            x, y, heading, _ = _pose(lane, roads, own, here, side[world, number])
            reached[world, number] = here if np.float32(here) < length else 0.0
            row = after[world, number]
            row[0], row[1], row[2] = x, y, (heading + math.pi) % (2 * math.pi) - math.pi
            if lane.columns[0] >= 0:
                row[lane.columns[0]] = speed
            if moves:
                turned = (heading - state[world, number, 2] + math.pi) % (2 * math.pi) - math.pi
                yaw_rate = turned / lane.time_step
                if lane.columns[1] >= 0:
                    row[lane.columns[1]] = yaw_rate
                if lane.columns[2] >= 0 and lane.columns[0] >= 0:
                    row[lane.columns[2]] = (speed - state[world, number, lane.columns[0]]) / lane.time_step
                if lane.columns[3] >= 0:
                    row[lane.columns[3]] = speed * yaw_rate
    return after, reached


@inlined
def _speed(lane: Lane, others: np.ndarray, number: int, car: np.ndarray, possible: float) -> float:
    """Of one of the opponents [M, S] of a world: what is possible, unless another car is ahead on its lane."""
    x, y, heading = np.float64(others[number, 0]), np.float64(others[number, 1]), np.float64(others[number, 2])
    cos, sin, speed = math.cos(heading), math.sin(heading), possible
    for other in range(len(others) + 1):
        if other == number:
            continue
        mate = car if other == len(others) else others[other]
        dx, dy = mate[0] - x, mate[1] - y
        ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
        if ahead > 0 and abs(aside) < 1.25 * lane.width:
            free = max(ahead - lane.length - lane.standstill, 0.0)
            speed = min(speed, free / lane.headway)
    if lane.columns[0] < 0:
        return speed
    before = np.float64(others[number, lane.columns[0]])
    return max(min(speed, before + lane.drive * lane.time_step), before - lane.brakes * lane.time_step, 0.0)


@inlined
def _pose(lane: Lane, roads: Roads, track: int, station: float, side: float) -> tuple[float, float, float, float]:
    """X, y and heading on a lane, and by how much the station advances for each metre along it.

    That is less outside of a bend, where the lane is longer than the centreline, and where it goes across the road.
    """
    first, after_last, length = roads.first[track], roads.first[track + 1], roads.lengths[track]
    segment = first + np.searchsorted(roads.stations[first:after_last], station, side="right") - 1
    end = roads.stations[segment + 1] if segment + 1 < after_last else length
    way = end - roads.stations[segment]
    share = (station - roads.stations[segment]) / way
    begin_x, begin_y, end_x, end_y = roads.ends[segment]
    turned = roads.headings[segment, 1] - roads.headings[segment, 0]
    heading = roads.headings[segment, 0] + share * turned
    left, right = _room(lane, roads, segment, 0, share), _room(lane, roads, segment, 2, share)
    line, slope = _line(lane, track, station, length)
    aside = min(max(line + side * (left if side > 0 else right), -right), left)
    x, y = begin_x + share * (end_x - begin_x), begin_y + share * (end_y - begin_y)
    along = max(1 - turned / way * aside, 0.2)
    course = heading + math.atan2(slope, along)
    return x - aside * math.sin(heading), y + aside * math.cos(heading), course, 1 / math.hypot(along, slope)


@inlined
def _room(lane: Lane, roads: Roads, segment: int, wall: int, share: float) -> float:
    """How far from the centreline lanes may be on one side, m."""
    begin, end = roads.room[segment, wall], roads.room[segment, wall + 1]
    return max(begin + share * (end - begin) - lane.edge, 0.0)


@inlined
def _line(lane: Lane, track: int, station: float, length: float) -> tuple[float, float]:
    """Offset of the line from the centreline, m, left positive, and by how much it changes in a metre."""
    first, places = lane.first[track], lane.first[track + 1] - lane.first[track]
    at = station / length * places
    place = min(int(at), places - 1)
    here, after = lane.offsets[first + place], lane.offsets[first + (place + 1) % places]
    return here + (at - place) * (after - here), (after - here) * places / length
