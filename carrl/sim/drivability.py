"""Whether a car can drive a road at all: whether it fits, turns tightly enough, and steers finely enough.

Shapes: `P` points of the centreline, `N` places spaced evenly along it.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from carrl.sim.driven import DrivenCar
from carrl.sim.sensor import Sensor
from carrl.tracks.inspection import road_widths

if TYPE_CHECKING:
    from carrl.sim.vehicle import VehicleModel
    from carrl.tracks.track import Track

_MOST_PLACES = 4000
"""Looked at along a road; on the Nordschleife they stand 5 m apart."""
_PLACES_A_WIDTH, _PLACES_A_TURN = 4, 8
"""How many places there are at least within a width of the road, and within the car's turn radius."""


@dataclass(frozen=True)
class Car:
    """What of a car decides whether a road suits it.

    Attributes:
        turn_radius: of the circle that it drives when it turns all the time, m.
        step_length: distance driven between two decisions, m; 0 of a car that brakes as far as it has to.
        body_radius: of its body, or half its width, m.
        near_wall: a wall this near to the middle of the car, square to the road, counts as near, m.
    """

    turn_radius: float = 7.2
    step_length: float = 1.0
    body_radius: float = 0.5
    near_wall: float = 1.0

    @staticmethod
    def of(vehicle: "VehicleModel", sensor: Sensor, proximity_threshold: float) -> "Car":
        """That of a simulation; the threshold is a share of the sensor's range, 0..1."""
        sideways = float(sensor.angles.clamp(-math.pi / 2, math.pi / 2).sin().abs().max())
        return Car(
            turn_radius=_turn_radius(vehicle),
            step_length=0.0 if isinstance(vehicle, DrivenCar) else vehicle.step_length,
            body_radius=vehicle.body.half_width,
            near_wall=sideways * proximity_threshold * sensor.max_range,
        )

    @property
    def sideways(self) -> float:
        """How far one step of turning moves it to the side, m."""
        turn = self.step_length / self.turn_radius if self.turn_radius else 0.0
        return self.step_length * math.sin(min(turn, math.pi / 2))


def _turn_radius(vehicle: "VehicleModel") -> float:
    """Of the circle through the ends of one step with the wheel turned fully, m; 0 where nothing is known of it."""
    if isinstance(vehicle, DrivenCar):
        return vehicle.turn_radius
    if "steer" not in vehicle.control_names:
        return 0.0
    control = torch.tensor([[float(name == "steer") for name in vehicle.control_names]])
    x, y, yaw, *_ = vehicle.step(torch.zeros(1, len(vehicle.state_names), dtype=torch.float64), control)[0].tolist()
    return abs(math.hypot(x, y) / (2 * math.sin(yaw / 2))) if math.sin(yaw / 2) else math.inf


def unsuitable(track: "Track", car: Car) -> list[str]:
    """What keeps a car from driving a road as it is meant, a phrase for each; none where it suits."""
    centreline, left, right = (line.double().numpy() for line in (track.centreline, track.left_wall, track.right_wall))
    width = float(road_widths(centreline, left, right).min())
    room = width / 2 - car.body_radius
    if room <= 0:
        return [f"the road is {metres(width)} wide and the car {metres(2 * car.body_radius)}"]
    phrases = []
    radius, station = tightest_bend(track, car)
    if radius < car.turn_radius:
        phrases.append(
            f"the bend at {station:.0f} m is driven with a turn radius of at most {metres(radius)}, and the car's is "
            f"{metres(car.turn_radius)}"
        )
    if car.sideways >= room:
        phrases.append(
            f"one step of turning moves the car {metres(car.sideways)} sideways, and the road, {metres(width)} wide, "
            f"leaves it {metres(room)}"
        )
    if car.near_wall >= width / 2:
        phrases.append(
            f"all of the road, {metres(width)} wide, is within {metres(car.near_wall)} of a wall, where the car counts "
            "as near it"
        )
    return phrases


def tightest_bend(track: "Track", car: Car) -> tuple[float, float]:
    """The largest turn radius with which a car comes round the tightest bend, m, and where that is, a station in m.

    Infinity where no bend is tighter than the circle that the car drives.

    A bend that turns by an angle a, of radius R along the middle, and that leaves the car w to each side, is driven
    from its outside by its inside to its outside with a radius of R + w / tan(a / 4)^2 at most. Every stretch between
    two places is looked at as such a bend, with the radius of the arc of that angle between its ends.
    """
    places, widths, spacing = _places(track, car)
    heading = _headings(places)
    middles = (places + np.roll(places, -1, axis=0)) / 2
    least, station = math.inf, 0.0
    for count in range(1, min(len(places) // 2, math.ceil(math.pi * car.turn_radius / spacing)) + 1):
        index = (np.arange(len(places)) + count) % len(places)
        turn = np.abs(heading[index] - heading + _lap(heading, places) * (index < count))
        turn = turn.clip(1e-6, math.pi)
        chord = np.linalg.norm(middles[index] - middles, axis=1)
        arc = chord / (2 * np.sin(turn / 2))
        if count == 1 and arc.min() >= car.turn_radius:
            break
        room = widths[(np.arange(len(places)) + (count + 1) // 2) % len(places)] / 2 - car.body_radius
        radius = arc + room.clip(min=0) / np.tan(turn / 4) ** 2
        first = int(radius.argmin())
        if radius[first] < least:
            least, station = float(radius[first]), (first + (count + 1) / 2) * spacing % track.length
    return least, station


def _places(track: "Track", car: Car) -> tuple[np.ndarray, np.ndarray, float]:
    """Places spaced evenly along the road, [N, 2], m, the width of the road there, [N], m, and the spacing, m."""
    points, left, right = (line.double().numpy() for line in (track.centreline, track.left_wall, track.right_wall))
    widths = road_widths(points, left, right)
    stations = np.concatenate([[0], np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).cumsum()])
    finest = min(float(np.median(widths)) / _PLACES_A_WIDTH, car.turn_radius / _PLACES_A_TURN)
    count = min(_MOST_PLACES, max(8, math.ceil(stations[-1] / finest)))
    even = np.arange(count) * stations[-1] / count
    columns = np.column_stack([points, widths]).T
    table = np.stack([np.interp(even, stations, np.append(column, column[0])) for column in columns], axis=1)
    return table[:, :2], table[:, 2], float(stations[-1] / count)


def _headings(places: np.ndarray) -> np.ndarray:
    """Of the way from each place to the next, counted on through full turns, [N], rad."""
    way = np.roll(places, -1, axis=0) - places
    return np.unwrap(np.arctan2(way[:, 1], way[:, 0]))


def _lap(heading: np.ndarray, places: np.ndarray) -> float:
    """By how much the road turns in a lap, rad: a multiple of a full turn."""
    last = heading[0] - heading[-1]
    return float((last + math.pi) % (2 * math.pi) - math.pi - last)


def metres(length: float) -> str:
    """A length for people: with two digits below 2 m, and one above."""
    return f"{length:.2f} m" if abs(length) < 2 else f"{length:,.1f} m"
