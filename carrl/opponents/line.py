"""Opponents that follow the road on a lane of their own, at a share of the speed that is possible there.

They are moved along their lanes, as if on rails: they never leave the road, need no rays, and keep their distance to
the cars ahead of them.

Shapes: `B` worlds, `M` opponents of each, `K` = M + 1 cars, `N` = B * M, `P` places along all tracks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError, TrackError
from carrl.machine_code import as_array
from carrl.opponents.pace import check_pace, drawn_pace, opponents_of, paces_of
from carrl.racing.reference_line import Floats, ReferenceLine
from carrl.racing.speed_profile import possible_speeds
from carrl.sim.driven import DrivenCar
from carrl.sim.kinematic import Kinematic
from carrl.sim.others import Others
from carrl.sim.places import Roads, stations_along
from carrl.sim.simulator import CarState
from carrl.sim.single_track import SingleTrack
from carrl.sim.traffic import Opponents, Traffic
from carrl.sim.vehicle import ConstantSpeed, VehicleModel
from carrl.task.checks import instance, number

if TYPE_CHECKING:
    from carrl.opponents.line_kernel import Lane

SPACING = 2.0
"""Of the places at which speeds are known, about, m."""
HEADWAY, STANDSTILL = 0.5, 0.25
"""From a car ahead: seconds, and at rest a share of the car's length."""
_SAME_ROAD = 0.02
"""By how much two lengths of the same road may differ, as a share."""
EDGE = 1.5
"""How many of their half widths lanes keep from the walls, as starts do."""


class Line(NamedTuple):
    """What the opponents know of the tracks and of the car.

    Attributes:
        lane: for the machine code.
        roads: the centrelines.
    """

    lane: "Lane"
    roads: Roads


@dataclass(frozen=True)
class LineOpponents(Opponents):
    """Follow the centreline or another line, or a lane beside it, at a share of the possible speed.

    For cars that only steer that is their speed; for others what grip, power and brakes allow on the centreline, and on
    another line the speed that it has there.

    Attributes:
        pace: share of the possible speed.
        spread: by how much an opponent's pace may be more or less, drawn for each episode.
        offset: how far its lane may be beside the line, as a share of the room beside the centreline, drawn for each
            episode.
        line: a CSV file of `carrl track lap-time --csv`; None for the centreline.
    """

    pace: float = 0.8
    spread: float = 0.1
    offset: float = 0.5
    line: str | None = None

    def __post_init__(self) -> None:
        """Raises ConfigError for a share out of its range, or a line that is no path."""
        check_pace(self.pace, self.spread)
        number("opponents.offset", self.offset, 0, 1, "a share between 0 and 1")
        instance("opponents.line", self.line, str)

    @property
    def files(self) -> Sequence[Path]:
        """The line's."""
        return () if self.line is None else (Path(self.line),)

    def prepare(self, traffic: Traffic) -> Line:
        """The possible speeds of the tracks.

        Raises:
            ConfigError: it is not known how fast the car can drive, or there is a line and more than one road.
            TrackError: the line cannot be read, or is not on the road.
        """
        from carrl.opponents.line_kernel import Lane  # Here, since Numba takes half a second to import.

        car, roads = traffic.vehicle, traffic.places.roads
        profiles = [_profile(roads, index, car) for index in range(len(roads.lengths))]
        if self.line is None:
            offsets = [np.zeros(len(each)) for each in profiles]
        else:
            offset, profile = _on_the_road(self.line, traffic, len(profiles[0]))
            offsets, profiles = [offset], [np.minimum(profile, profiles[0]) if _has_one_speed(car) else profile]
        names, outline = car.state_names, car.body.outline
        columns = ("speed", "yaw_rate", "acceleration", "lateral_acceleration")
        is_driven = isinstance(car, DrivenCar)
        lane = Lane(
            speeds=np.concatenate(profiles),
            offsets=np.concatenate(offsets),
            first=np.cumsum([0] + [len(each) for each in profiles]),
            time_step=float(car.time_step),
            length=float(outline.length),
            width=float(outline.width),
            edge=EDGE * car.body.half_width,
            drive=float(getattr(car, "max_acceleration", np.inf)) if is_driven else np.inf,
            brakes=_brakes(car) if is_driven else np.inf,
            headway=HEADWAY,
            standstill=STANDSTILL * outline.length,
            columns=np.array([names.index(name) if name in names else -1 for name in columns]),
        )
        return Line(lane, roads)

    def begin(self, traffic: Traffic, others: Others, draws: Tensor, track: Tensor) -> Others:
        """With a pace and a lane of their own, no faster than their pace allows there."""
        pace = drawn_pace(self.pace, self.spread, draws[..., 0])
        lane = (self.offset * (2 * draws[..., 1] - 1)).float().to(pace.device)
        begun = replace(others, pace=pace.to(others.state.device), lane=lane.to(others.state.device))
        return replace(begun, state=self._follow(traffic, begun, track, None)[0])

    def drive(self, traffic: Traffic, cars: CarState) -> Others:
        """Along their lanes, no faster than lets them keep their distance."""
        others = opponents_of(cars)
        state, station = self._follow(traffic, others, cars.track, cars.state)
        return replace(others, state=state, station=station)

    def _follow(self, traffic: Traffic, others: Others, track: Tensor, own: Tensor | None) -> tuple[Tensor, Tensor]:
        """States and stations after a step among the learners in these states; without these, of being there."""
        from carrl.opponents.line_kernel import follow_lanes

        line: Line = traffic.prepared
        arrays = (
            as_array(each.cpu(), torch.float32)
            for each in (others.state, others.station, paces_of(others), others.lane)
        )
        cars = others.state[:, 0] if own is None else own
        found = follow_lanes(
            line.lane,
            line.roads,
            *arrays,
            as_array(track.cpu(), torch.int64),
            as_array(cars.cpu(), torch.float32),
            own is not None,
        )
        state, station = (torch.from_numpy(each).to(others.state.device) for each in found)
        return state, station


def _brakes(car: VehicleModel) -> float:
    return float(getattr(car, "max_braking", getattr(car, "max_acceleration", np.inf)))


def _has_one_speed(car: VehicleModel) -> bool:
    return isinstance(car, ConstantSpeed)


def _on_the_road(path: str, traffic: Traffic, places: int) -> tuple[Floats, Floats]:
    """A line's offset from the centreline, m, left positive, and its speed, m/s, at evenly spaced places of the road.

    Raises:
        ConfigError: there are several roads, as there are with mirrored or reversed starts.
        TrackError: the line cannot be read, or is not on the road.
    """
    if len(traffic.tracks) > 1:
        raise ConfigError(
            f"opponents.line is of one road, and there are {len(traffic.tracks)}, variants included; leave it out, or "
            "train on one track with start.mirrored=false start.reversed=false"
        )
    try:
        line = ReferenceLine.read(path)
    except TrackError as error:
        raise TrackError(f"opponents.line is '{path}', and {error}; carrl track lap-time --csv writes one") from error
    road = traffic.track
    poses = torch.from_numpy(np.stack([line.x, line.y, line.heading], axis=1)).float()
    stations, sides = stations_along(road, poses, 0.0, float(np.diff(line.closed().distance).max()))
    length, roads = road.length, traffic.places.roads
    room = [np.interp(stations, roads.stations, roads.room[:, wall], period=length) for wall in (0, 2)]
    if abs(line.track_length / length - 1) > _SAME_ROAD or (np.abs(sides) > 1).any():
        raise TrackError(f"opponents.line: '{Path(path).name}' is no line of track '{road.name}'")
    offset = sides * np.where(sides > 0, *room)
    at = np.arange(places) * length / places
    return np.interp(at, stations, offset, period=length), np.interp(at, stations, line.speed, period=length)


def _profile(roads: Roads, track: int, car: VehicleModel) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The possible speeds at evenly spaced places of a track, m/s."""
    length = float(roads.lengths[track])
    count = max(8, round(length / SPACING))
    if isinstance(car, ConstantSpeed):
        return np.full(count, float(car.speed))
    if not isinstance(car, SingleTrack | Kinematic):
        raise ConfigError(
            f"opponents=line does not know how fast a {type(car).__name__} can drive; choose vehicle=paper, bicycle, "
            "kinematic or single_track, or opponents=rule"
        )
    own = slice(roads.first[track], roads.first[track + 1])
    headings = np.append(roads.headings[own, 0], roads.headings[own, 0][0] + roads.turns[track])
    at = np.arange(count + 1) * length / count
    turned = np.diff(np.interp(at, np.append(roads.stations[own], length), headings))
    return possible_speeds(turned * count / length, length / count, car)
