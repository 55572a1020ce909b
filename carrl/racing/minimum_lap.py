"""The minimum lap: the point mass's first, then the car's from there.

Shapes: `N` stations, `S` states. Units: m, s, rad.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from carrl.errors import ConfigError, TrackError
from carrl.racing.cross_sections import CrossSections, Floats
from carrl.racing.models import Car, PointMass
from carrl.racing.optimal_control import LapProblem, Solution, Unknowns
from carrl.racing.reference_line import ReferenceLine
from carrl.racing.speed_profile import possible_speeds
from carrl.sim.driven import GRAVITY
from carrl.sim.single_track import SingleTrack

if TYPE_CHECKING:
    from carrl.sim.vehicle import VehicleModel
    from carrl.tracks.track import Track

SPACING, FEWEST = 1.11, 1000
"""Of the stations by default, in lengths of the car, 5 m for a car of 4.5 m; closer where that makes fewer of them."""
FEWEST_STATIONS = 8
"""That any grid may have."""
STARTS = ("point mass", "middle", "right")
"""Guesses to begin with: the lap of a point mass with less grip than the car; one along the middle of the road, and one
near its right wall, both as fast as that grip allows."""
AT_LIMIT = 0.98
"""A car that uses this share of its grip is at the limit."""
AT_WALL = 0.01
"""A body this near to a wall, in widths of the car, touches it."""
GUESS_GRIP = 0.7
"""Share of the car's grip in guesses: from laps that ask for more than the car can do IPOPT ended at slower ones."""
_SLOW = 0.2
"""Speed of the point mass's guess, as a share of full speed."""


@dataclass(frozen=True, eq=False)
class MinimumLap:
    """A minimum lap and how it was found.

    Attributes:
        line: the lap.
        model: `single track` or `point mass`.
        spacing: of the stations, m.
        margin: that the body keeps to the walls, m.
        iterations: of IPOPT, the point mass's included.
        seconds: of CPU time.
        at_grip_limit: share of the time at the limit of grip; None for linear tyres, which have none.
        at_walls: share of the time at a wall.
    """

    line: ReferenceLine
    model: str
    spacing: float
    margin: float
    iterations: int
    seconds: float
    at_grip_limit: float | None
    at_walls: float

    @property
    def lap_time(self) -> float:
        """From the start line to the start line, s."""
        return self.line.lap_time


def minimum_lap(
    track: "Track",
    vehicle: "VehicleModel",
    spacing: float | None = None,
    margin: float = 0.0,
    start: str = STARTS[0],
    coarser: MinimumLap | None = None,
) -> MinimumLap:
    """The fastest flying lap of a car on a track, by optimal control.

    It is found on half as many stations first, beginning with a guess, and from there on all of them: on many at once
    IPOPT may end at a lap that is slower, but faster than all near it.

    Args:
        track: any.
        vehicle: a single-track car.
        spacing: of the stations, m; by default `SPACING` lengths of the car, and at least `FEWEST` stations.
        margin: that the body keeps to the walls, m.
        start: the guess, one of `STARTS`.
        coarser: the same lap on a coarser grid, to begin with instead.

    Raises:
        CarrlError: the car or the road is none that this can be found for, or none was found.
    """
    car = checked_car(vehicle)
    sections = sections_of(track, car, spacing, margin)
    iterations, seconds = 0, 0.0
    if coarser is None:
        half = sections_of(track, car, min(2 * sections.spacing, track.length / FEWEST_STATIONS), margin)
        coarser = _from_guess(half, car, margin, start)
        iterations, seconds = coarser.iterations, coarser.seconds
    problem = LapProblem(Car(car), sections, margin)
    solution = problem.solve(_finer(coarser.line, sections, car), warm=True)
    return _lap(
        problem, replace(solution, iterations=solution.iterations + iterations, seconds=solution.seconds + seconds)
    )


def point_mass_lap(
    track: "Track", vehicle: "VehicleModel", spacing: float | None = None, margin: float = 0.0
) -> MinimumLap:
    """The fastest flying lap of a mass with the grip, the power and the width of a car with brush tyres.

    The car itself is slower: it slides a little, turns, and takes time to steer.

    Raises:
        CarrlError: as `minimum_lap`, or the car has linear tyres, whose grip has no limit.
    """
    car = checked_car(vehicle)
    if car.tyre == "linear":
        raise ConfigError("a point mass has a limit of grip, and vehicle.tyre=linear has none; leave out --quick")
    sections = sections_of(track, car, spacing, margin)
    problem = LapProblem(PointMass(car), sections, margin)
    return _lap(problem, problem.solve(_slow_lap(sections, car)))


def checked_car(vehicle: "VehicleModel") -> SingleTrack:
    """The vehicle, if it is one whose minimum lap can be found.

    Raises:
        ConfigError: it is not.
    """
    if type(vehicle) is not SingleTrack:  # one of its kind may move in another way
        raise ConfigError(
            f"the minimum lap time is that of vehicle=single_track, and this is a {type(vehicle).__name__}; choose "
            "that one, with a vehicle.preset"
        )
    return vehicle


def sections_of(track: "Track", car: SingleTrack, spacing: float | None, margin: float) -> CrossSections:
    """The road as the problem has it.

    Raises:
        CarrlError: the spacing is not one, or the car does not fit.
    """
    wanted = min(SPACING * car.length, track.length / FEWEST) if spacing is None else spacing
    most = track.length / FEWEST_STATIONS
    if not 0 < wanted <= most:
        raise ConfigError(f"--spacing is {wanted:g}; it must be more than 0 and at most {most:.3g} m here")
    if not margin >= 0:
        raise ConfigError(f"--margin is {margin:g}; it must be 0 or more")
    sections = CrossSections.of(track, wanted, car.length / 2)
    least = float(sections.width.min())
    if least <= car.width + 2 * margin:
        raise TrackError(
            f"track '{track.name}': the road is {least:.2f} m wide in places, and the car with its margins "
            f"{car.width + 2 * margin:.2f} m; take a smaller --margin or another car"
        )
    return sections


def _from_guess(sections: CrossSections, car: SingleTrack, margin: float, start: str) -> MinimumLap:
    calm = replace(car, friction=GUESS_GRIP * car.friction)
    iterations, seconds = 0, 0.0
    if start == STARTS[0]:
        mass = LapProblem(PointMass(calm), sections, margin).solve(_slow_lap(sections, calm))
        guess, iterations, seconds = mass.unknowns, mass.iterations, mass.seconds
    else:
        offset = -(sections.width / 2 - car.width).clip(min=0) if start == "right" else np.zeros_like(sections.width)
        guess = _lap_along(sections, calm, offset)
    problem = LapProblem(Car(car), sections, margin)
    solution = problem.solve(_as_car(guess, calm))
    return _lap(
        problem, replace(solution, iterations=solution.iterations + iterations, seconds=solution.seconds + seconds)
    )


def _slow_lap(sections: CrossSections, car: SingleTrack) -> Unknowns:
    """A point mass's along the middle, at one speed."""
    ways, speed = _steps(sections.middle), _SLOW * car.max_speed
    still = np.zeros_like(ways)
    return Unknowns(np.stack([still, still, still + speed], axis=1), np.zeros((len(ways), 2)), ways / speed)


def _lap_along(sections: CrossSections, car: SingleTrack, offset: Floats) -> Unknowns:
    """A point mass's beside the middle, at these offsets, as fast as its grip allows."""
    places = sections.middle + sections.across * offset[:, None]
    ways = _steps(places)
    direction = np.arctan2(*np.flip(np.roll(places, -1, axis=0) - places, axis=1).T)
    turns = np.angle(np.exp(1j * (direction - np.roll(direction, 1))))
    bends = turns / ((ways + np.roll(ways, 1)) / 2)
    speed = possible_speeds(bends, ways, car)
    mean, grip = (speed + np.roll(speed, -1)) / 2, car.friction * GRAVITY
    controls = np.stack([(np.roll(speed, -1) ** 2 - speed**2) / (2 * ways), speed**2 * bends], axis=1) / grip
    return Unknowns(np.stack([offset, np.zeros_like(offset), speed], axis=1), controls, ways / mean)


def _steps(places: Floats) -> Floats:
    """From each place to the next, [N], m."""
    return np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)


def _as_car(lap: Unknowns, car: SingleTrack) -> Unknowns:
    """A car that drives a point mass's lap without sliding, its wheels as for a slow turn of that radius."""
    offset, heading, speed = lap.states.T
    grip = car.friction * GRAVITY
    yaw_rate = grip * lap.controls[:, 1] / speed
    steering = (car.wheelbase * yaw_rate / speed).clip(-car.max_steering, car.max_steering)
    states = np.stack([offset, heading, speed, np.zeros_like(speed), yaw_rate, steering], axis=1)
    return Unknowns(states, np.stack([np.zeros_like(speed), grip * lap.controls[:, 0]], axis=1), lap.times)


def _finer(line: ReferenceLine, sections: CrossSections, car: SingleTrack) -> Unknowns:
    """A lap between the stations at which it is known."""
    closed = line.closed()
    at = sections.stations

    def between(values: Floats) -> Floats:
        return np.interp(at, closed.station, values)

    slip, speed = between(closed.slip), between(closed.speed)
    moving = (speed * np.cos(slip), speed * np.sin(slip)) if car.tyre == "brush" else (speed, slip)
    against = between(closed.heading - np.interp(closed.station, *_heading_of(sections)))
    states = [between(closed.offset), against, *moving, between(closed.yaw_rate), between(closed.steering)]
    index = np.searchsorted(line.station, at, side="right") - 1
    times = np.diff(between(closed.time), append=line.lap_time)
    controls = np.stack([line.steering_rate[index], line.acceleration[index]], axis=1)
    return Unknowns(np.stack(states, axis=1), controls, times)


def _heading_of(sections: CrossSections) -> tuple[Floats, Floats]:
    """Stations of a lap and the road's heading there, [N + 1] each."""
    return (
        np.append(sections.stations, sections.track_length),
        np.append(sections.heading, sections.heading[0] + sections.turn),
    )


def _lap(problem: LapProblem, solution: Solution) -> MinimumLap:
    """What was found, as a line with its figures."""
    sections, model, car = problem.sections, problem.model, problem.model.car
    states, controls, times = solution.unknowns
    places = sections.middle + sections.across * states[:, :1]
    heading = sections.heading + states[:, 1]
    if isinstance(model, PointMass):
        speed, slip, yaw_rate = states[:, 2], np.zeros(len(states)), model.grip * controls[:, 1] / states[:, 2]
        steering, steering_rate = (car.wheelbase * yaw_rate / speed), np.zeros(len(states))
        acceleration, used = model.grip * controls[:, 0], np.hypot(*controls.T)
    else:
        first, second, yaw_rate, steering = states[:, 2:].T
        has_brush = car.tyre == "brush"
        speed = np.hypot(first, second) if has_brush else first
        slip = np.arctan2(second, first) if has_brush else second
        steering_rate, acceleration = controls.T
        used = None
    line = ReferenceLine.of(
        station=sections.stations,
        time=np.append(0, times.cumsum())[:-1],
        places=places,
        offset=states[:, 0],
        heading=heading,
        speed=speed,
        slip=slip,
        yaw_rate=yaw_rate,
        steering=steering,
        steering_rate=steering_rate,
        acceleration=acceleration,
        lap_time=float(times.sum()),
        track_length=sections.track_length,
        turn=sections.turn,
    )
    if used is None:
        used = line.grip_used(car.friction * GRAVITY)
    room = problem.clearances(solution.unknowns).min(axis=1)
    return MinimumLap(
        line=line,
        model="point mass" if isinstance(model, PointMass) else "single track",
        spacing=sections.spacing,
        margin=problem.margin,
        iterations=solution.iterations,
        seconds=solution.seconds,
        at_grip_limit=None if car.tyre == "linear" else _share(used >= AT_LIMIT, times),
        at_walls=_share(room <= problem.margin + AT_WALL * car.width, times),
    )


def _share(where: np.ndarray, times: Floats) -> float:
    return float(times[where].sum() / times.sum())
