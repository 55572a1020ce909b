"""Where cars are along their roads, and how the road goes on from there.

A car's place is its nearest point of the centreline near its last place: a road may cross itself or come close to
itself, where the nearest point of all is on another stretch. Made on demand, since few tasks ask for it.

Shapes: `B` cars, `T` tracks, `P` points of all centrelines, `K` stretches of road. Lengths are in metres, angles in
radians counter-clockwise from +x.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.machine_code import as_array, compiled
from carrl.rows import Rows

if TYPE_CHECKING:
    from carrl.tracks.track import Track

_LEAST_STRETCH = 1.0
"""Between two places ahead, m: that of a curvature is a mean over so much of the road at least."""
_LEAST_ROOM = 0.01


@dataclass
class Place(Rows):
    """Where cars are on their roads.

    Attributes:
        station: of the projection on the centreline, [B], float32, m.
        progress: how far that is from the last place along the centreline, [B], float32, m; less than 0 backwards.
        offset: from the centreline, [B], float32, m, left positive.
        heading_error: the heading against the direction of the centreline, [B], float32, rad, in [-pi, pi).
        side: the offset as a share of the way to the wall on that side, [B], float32: -1 right edge .. +1 left edge.
    """

    station: Tensor
    progress: Tensor
    offset: Tensor
    heading_error: Tensor
    side: Tensor


class Roads(NamedTuple):
    """Centrelines end to end, float64; each segment begins at the point of its index.

    Attributes:
        ends: x and y of the begin and the end of each segment, [P, 4], m.
        stations: of the begin of each segment, [P], m.
        headings: of the road at the begin and the end of each segment, counted on through full turns, [P, 2], rad.
        room: to the left wall at the begin and the end of each segment, and to the right wall, [P, 4], m.
        first: segment of each track, and at the end P, [T + 1], int64.
        lengths: [T], m.
        turns: by how much the road turns in a lap, [T], rad.
    """

    ends: np.ndarray
    stations: np.ndarray
    headings: np.ndarray
    room: np.ndarray
    first: np.ndarray
    lengths: np.ndarray
    turns: np.ndarray


class Places:
    """Finds cars on the roads of some tracks.

    Args:
        roads: points of the centreline, the left and the right wall of each track, [P, 3, 2], m.
        gate_counts: how many gates each track has.
        step_length: the longest way of a car between two places, m.

    Attributes:
        roads: all that is known of them.
    """

    def __init__(self, roads: Sequence[Tensor], gate_counts: Sequence[int], step_length: float) -> None:
        """Lays the centrelines end to end."""
        each = [_road(road.double().numpy()) for road in roads]
        ends, stations, headings, room, lengths, turns = zip(*each, strict=True)
        first = np.cumsum([0] + [len(road) for road in roads])
        self.roads = Roads(
            ends=np.concatenate(ends),
            stations=np.concatenate(stations),
            headings=np.concatenate(headings),
            room=np.concatenate(room),
            first=first,
            lengths=np.array(lengths),
            turns=np.array(turns),
        )
        self._gate_gaps = self.roads.lengths / np.array(gate_counts)
        widest = np.maximum.reduceat(self.roads.room[:, [0, 2]].sum(axis=1), first[:-1])
        self._reach = 2 * step_length + widest  # a corner's sides are no further apart for a car between the walls
        none, nothing = torch.zeros(0, dtype=torch.int64), torch.zeros(0)
        self.after(torch.zeros(0, 3), none, nothing)  # compiles at once, so that no step takes longer than the others
        self.curvatures(none, nothing, nothing, nothing, 1)

    def on_the_way(self, pose: Tensor, track: Tensor, next_gate: Tensor) -> Place:
        """The places of cars [B, S] that are between the gate [B] that counts next and the one before it."""
        own = track.cpu().numpy()
        gap = self._gate_gaps[own]
        return self._find(pose, track, (next_gate.cpu().numpy() + 0.5) * gap, gap / 2 + 1, progress=0)

    def after(self, pose: Tensor, track: Tensor, station: Tensor) -> Place:
        """The places of cars [B, S] whose last stations were these, [B], m."""
        return self._find(pose, track, station.cpu().double().numpy(), self._reach[track.cpu().numpy()])

    def curvatures(self, track: Tensor, station: Tensor, begin: Tensor, spacing: Tensor, count: int) -> Tensor:
        """How the road bends at `count` places ahead, as a mean over the stretch about each.

        Args:
            track: of each car, [B], int64.
            station: of each car, [B], m.
            begin: from there to the first of the places, [B], m.
            spacing: between two of them, [B], m; at least 1 m in any case.
            count: K.

        Returns:
            1 / radius, [B, K], float32, 1/m, left positive.
        """
        ahead = [as_array(each.cpu(), torch.float64) for each in (station, begin, spacing)]
        found = _curvatures(self.roads, as_array(track.cpu(), torch.int64), *ahead, count)
        return torch.from_numpy(found).to(station.device)

    def _find(
        self, pose: Tensor, track: Tensor, near: np.ndarray, reach: np.ndarray, progress: float | None = None
    ) -> Place:
        cars = as_array(pose.cpu(), torch.float32), as_array(track.cpu(), torch.int64)
        place = Place(*(torch.from_numpy(each).to(pose.device) for each in _find(self.roads, *cars, near, reach)))
        if progress is not None:
            place.progress = torch.full_like(place.progress, progress)
        return place


def stations_along(track: "Track", poses: Tensor, start: float, step_length: float) -> tuple[np.ndarray, np.ndarray]:
    """Where along a road each moment of a drive was, each near the one before, as a road may cross itself.

    Args:
        track: of the road.
        poses: [T, 3], m, m, rad.
        start: station near the first of them, m.
        step_length: the longest way between two of them, m.

    Returns:
        Stations, [T], float32, m, in [0, length), and sides as in `Place`, [T], float32.
    """
    places, only = Places([track.road], [track.gate_count], step_length), torch.zeros(1, dtype=torch.int64)
    place = places.on_the_way(poses[:1], only, track.next_gate(torch.tensor([start])))
    stations, sides = [], []
    for pose in poses:
        place = places.after(pose[None], only, place.station)
        stations.append(place.station)
        sides.append(place.side)
    return torch.cat(stations).numpy(), torch.cat(sides).numpy()


def _road(road: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float, float]:
    """What `Roads` has of one track, [P, 3, 2]: the ends, stations, headings, room, the length and the turn."""
    after = np.roll(road, -1, axis=0)
    way = after[:, 0] - road[:, 0]
    steps = np.hypot(way[:, 0], way[:, 1])
    direction = np.arctan2(way[:, 1], way[:, 0])
    turn = _wrapped(direction - np.roll(direction, 1))  # at each point
    at_points = direction[0] - turn[0] / 2 + np.append(0, np.cumsum((turn + np.roll(turn, -1)) / 2))
    room = np.hypot(*(road[:, 1:] - road[:, :1]).transpose(2, 0, 1)).clip(min=_LEAST_ROOM)
    room_after = np.roll(room, -1, axis=0)
    return (
        np.concatenate([road[:, 0], after[:, 0]], axis=1),
        np.append(0, np.cumsum(steps)[:-1]),
        np.stack([at_points[:-1], at_points[1:]], axis=1),
        np.stack([room[:, 0], room_after[:, 0], room[:, 1], room_after[:, 1]], axis=1),
        float(steps.sum()),
        float(at_points[-1] - at_points[0]),
    )


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + math.pi) % (2 * math.pi) - math.pi


@compiled
def _find(
    roads: Roads, state: np.ndarray, track: np.ndarray, near: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, ...]:
    """The entries of `Place` for cars [B, S], no further than the reach [B] from the stations near them [B], m."""
    cars = len(state)
    if state.shape[1] < 3 or len(track) != cars or len(near) != cars or len(reach) != cars:
        raise ValueError("state, track and station must be of the same number of cars, a state begin with a pose")
    station, progress, offset = np.empty(cars, np.float32), np.empty(cars, np.float32), np.empty(cars, np.float32)
    heading_error, side = np.empty(cars, np.float32), np.empty(cars, np.float32)
    ends, room = roads.ends, roads.room
    for car in range(cars):
        if not 0 <= track[car] < len(roads.lengths):
            raise ValueError("a track's index is not one of those that the simulator has")
        first, after_last, length = roads.first[track[car]], roads.first[track[car] + 1], roads.lengths[track[car]]
        last = near[car] % length if math.isfinite(near[car]) else 0.0
        own = first + np.searchsorted(roads.stations[first:after_last], last, side="right") - 1
        x, y, heading = np.float64(state[car, 0]), np.float64(state[car, 1]), np.float64(state[car, 2])
        best, nearest, share_there = own, np.inf, 0.0
        for direction in (1, -1):
            segment, way = own, 0.0
            for _ in range(after_last - first):
                begin_x, begin_y, end_x, end_y = ends[segment]
                edge_x, edge_y = end_x - begin_x, end_y - begin_y
                squared_length = edge_x * edge_x + edge_y * edge_y
                share = ((x - begin_x) * edge_x + (y - begin_y) * edge_y) / squared_length
                share = min(max(share, 0.0), 1.0)
                away_x, away_y = x - begin_x - share * edge_x, y - begin_y - share * edge_y
                distance = away_x * away_x + away_y * away_y
                if distance < nearest:
                    best, nearest, share_there = segment, distance, share
                if direction > 0:
                    end = roads.stations[segment + 1] if segment + 1 < after_last else length
                    way += end - (last if segment == own else roads.stations[segment])
                    segment = segment + 1 if segment + 1 < after_last else first
                else:
                    end = roads.stations[segment + 1] if segment + 1 < after_last else length
                    way += (last if segment == own else end) - roads.stations[segment]
                    segment = segment - 1 if segment > first else after_last - 1
                if way > reach[car] or 2 * way > length:
                    break
        begin_x, begin_y, end_x, end_y = ends[best]
        edge_x, edge_y = end_x - begin_x, end_y - begin_y
        found = roads.stations[best] + share_there * math.sqrt(edge_x * edge_x + edge_y * edge_y)
        station[car] = found - length if found >= length else found
        moved = np.float64(station[car]) - last
        progress[car] = moved - length * math.floor(moved / length + 0.5)
        along = roads.headings[best, 0] + share_there * (roads.headings[best, 1] - roads.headings[best, 0])
        away_x, away_y = x - begin_x - share_there * edge_x, y - begin_y - share_there * edge_y
        is_left = math.cos(along) * away_y - math.sin(along) * away_x >= 0
        distance = math.sqrt(away_x * away_x + away_y * away_y)
        wall = 0 if is_left else 2
        space = room[best, wall] + share_there * (room[best, wall + 1] - room[best, wall])
        signed = distance if is_left else -distance
        error = (heading - along + math.pi) % (2 * math.pi) - math.pi
        is_somewhere = math.isfinite(signed) and math.isfinite(error)  # what is no number must not reach a network
        offset[car], side[car] = (signed, signed / space) if is_somewhere else (0.0, 0.0)
        heading_error[car] = error if is_somewhere else 0.0
    return station, progress, offset, heading_error, side


@compiled
def _curvatures(
    roads: Roads, track: np.ndarray, station: np.ndarray, begin: np.ndarray, spacing: np.ndarray, count: int
) -> np.ndarray:
    """What `Places.curvatures` tells, [B, K]."""
    cars = len(track)
    if len(station) != cars or len(begin) != cars or len(spacing) != cars:
        raise ValueError("track, station, begin and spacing must be of the same number of cars")
    curvatures = np.empty((cars, count), np.float32)
    for car in range(cars):
        if not 0 <= track[car] < len(roads.lengths):
            raise ValueError("a track's index is not one of those that the simulator has")
        first, after_last, length = roads.first[track[car]], roads.first[track[car] + 1], roads.lengths[track[car]]
        stretch = max(spacing[car], _LEAST_STRETCH)
        heading_before = 0.0
        for edge in range(count + 1):
            there = station[car] + begin[car] + (edge - 0.5) * stretch
            laps = math.floor(there / length)
            there -= laps * length
            segment = first + np.searchsorted(roads.stations[first:after_last], there, side="right") - 1
            segment = min(max(segment, first), after_last - 1)
            end = roads.stations[segment + 1] if segment + 1 < after_last else length
            share = (there - roads.stations[segment]) / (end - roads.stations[segment])
            heading = roads.headings[segment, 0] + share * (roads.headings[segment, 1] - roads.headings[segment, 0])
            heading += laps * roads.turns[track[car]]
            if edge > 0:
                curvatures[car, edge - 1] = (heading - heading_before) / stretch
            heading_before = heading
    return curvatures
