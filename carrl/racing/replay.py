"""The controls of a line in the simulator: how far its car drifts from the line when nobody corrects it.

Units: m, s, rad.
"""

from dataclasses import dataclass, replace

import numpy as np

from carrl.racing.cross_sections import Floats
from carrl.racing.reference_line import ReferenceLine
from carrl.sim.single_track import SingleTrack

_STEP = 0.01
"""Of the simulator, s for a car of 4.5 m: the controls of a line change from station to station."""


@dataclass(frozen=True)
class Drift:
    """How far a car is from the line.

    Attributes:
        station: where it began, m.
        distance: driven since, m.
        apart: between the car and where the line has it at that time, m.
        speed: the difference of the speeds, m/s.
    """

    station: float
    distance: float
    apart: float
    speed: float


def drifts(line: ReferenceLine, car: SingleTrack, distance: float, starts: int) -> list[Drift]:
    """Drives the line's controls with the simulator's machine code, open loop, from places spaced evenly along it.

    Args:
        line: a lap of this car.
        car: whose steering wheel and pedals are replaced by the line's controls.
        distance: that each drive has, m, at most a lap.
        starts: how many drives.
    """
    step = _STEP * car.length / 4.5
    plain = replace(
        car, time_step=step, substep=step, steering="rate", pedals="one", integrator="rk4", min_speed=car.min_speed
    )
    return [_drift(line, plain, index * len(line) // starts, distance) for index in range(starts)]


def _drift(line: ReferenceLine, car: SingleTrack, first: int, distance: float) -> Drift:
    closed, step = line.closed(), car.time_step
    begin = closed.distance[first]
    end_time = _at(line, closed.distance, closed.time, line.length, line.lap_time, begin + distance)
    steps = int((end_time - closed.time[first]) / step)
    times = closed.time[first] + step * np.arange(steps + 1)
    steer, pedal = (_means(line, each, times) for each in (line.steering_rate, line.acceleration))
    state = np.zeros((1, len(car.state_names)), np.float32)
    values = {"heading": closed.heading[first], "speed": closed.speed[first], "yaw_rate": closed.yaw_rate[first]}
    values |= {"slip": closed.slip[first], "steering": closed.steering[first]}
    for name, value in values.items():
        state[0, car.state_names.index(name)] = value
    constants = np.array(car.constants)
    for turn, drive in zip(steer / car.steering_rate, pedal / car.max_acceleration, strict=True):
        control = np.array([[turn, drive]], np.float32)
        state = car.kernel(state, control, constants)
    end = times[-1]
    where = [_at(line, closed.time, each, line.lap_time, 0.0, end) for each in (closed.x, closed.y)]
    apart = np.hypot(*(state[0, :2] + line.places[first] - where))
    wanted = _at(line, closed.time, closed.speed, line.lap_time, 0.0, end)
    return Drift(float(line.station[first]), distance, float(apart), float(state[0, 3] - wanted))


def _at(line: ReferenceLine, key: Floats, values: Floats, period: float, later: float, where: float) -> float:
    """A closed column's value where another one has this value, also beyond a lap."""
    laps = np.floor(where / period)
    return float(np.interp(where - laps * period, key, values) + laps * later)


def _means(line: ReferenceLine, control: Floats, times: Floats) -> Floats:
    """The mean of a control that is constant from station to station, between each two times, [T]."""
    ends = np.append(line.time, line.lap_time)
    sums = np.append(0, (control * np.diff(ends)).cumsum())
    laps = np.floor(times / line.lap_time)
    total = np.interp(times - laps * line.lap_time, ends, sums) + laps * sums[-1]
    return np.diff(total) / np.diff(times)
