"""A driver that knows the map: it follows the minimum lap of a car with less grip, at some distance from the walls.

Shapes: `B` cars, `C` controls. Units: m, s, rad; to the left positive.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.evaluation.rollout import Policy
from carrl.racing.kept_laps import kept_lap
from carrl.racing.reference_line import ReferenceLine
from carrl.sim.driven import GRAVITY
from carrl.sim.sensor import Sensor
from carrl.sim.single_track import SingleTrack
from carrl.task.action import ActionMap, ContinuousActions
from carrl.task.episode import ObservationContext
from carrl.task.observation import Observation, Part
from carrl.task.road import WIDE, RoadTerm
from carrl.task.task import World
from carrl.tracks.track import Track
import os
E_ = lambda n, d: float(os.environ.get(n, d))
GRIP, MARGIN = E_("GRIP", 0.7), E_("MARGIN", 0.3)
SIGHT, NEAREST = E_("SIGHT", 0.6), E_("NEAREST", 2.0)
LEAD, LEAD_A, LEAD_V = E_("LEAD", 0.8), E_("LEAD_A", 0.5), E_("LEAD_V", 0.5)
PACE_GAIN = E_("PACE", 2.0)
DAMP = E_("DAMP", 0.1)
QUICK = E_("QUICK", 1) > 0
APPROACH = E_("APPROACH", 0.2)
BRAKING = E_("BRAKING", 0.5)
USED = E_("USED", 0.95)


class Sight(NamedTuple):
    offset: Tensor
    course: Tensor
    speed: Tensor
    yaw_rate: Tensor
    wheels: Tensor
    curvature: Tensor
    pace: Tensor
    acceleration: Tensor


def line_driver_of(world: World, tracks: Sequence[Track]) -> tuple[World, Policy]:
    car = world.vehicle
    if type(car) is not SingleTrack:
        raise ConfigError("no")
    lines = {track: line_of(track, car) for track in tracks}
    sees = Observation({"line": LineAhead(lines, car.time_step)})
    return replace(world, observation=sees, action=ContinuousActions(car.control_names)), LineDriver(car)


def line_of(track: Track, car: SingleTrack) -> ReferenceLine:
    careful = replace(
        car,
        tyre="brush",
        integrator="rk4",
        pedals="one",
        max_acceleration=BRAKING * car.friction * GRAVITY,
        power_speed=car.power_speed * car.max_acceleration / (BRAKING * car.friction * GRAVITY),
        friction=GRIP * car.friction,
        front_stiffness=car.front_stiffness / GRIP,
        rear_stiffness=car.rear_stiffness / GRIP,
    )
    return kept_lap(track, careful, margin=MARGIN * car.width, quick=QUICK).line


@dataclass(frozen=True)
class LineAhead(RoadTerm):
    lines: Mapping[Track, ReferenceLine]
    time_step: float

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        return Part(name, len(Sight._fields), -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        cars = context.state.cars
        station = self._place(context).station.double().numpy()
        values = [context.value(name).double().numpy() for name in ("x", "y", "heading", "speed", "slip", "yaw_rate", "steering")]
        columns = np.stack([station, *values])
        seen = np.empty((len(station), len(Sight._fields)))
        for index in cars.track.unique().tolist():
            own = (cars.track == index).numpy()
            seen[own] = self._sight(self.lines[context.simulator.tracks[index]].closed(), *columns[:, own])
        return torch.from_numpy(seen).float()

    def _sight(self, line, station, x, y, heading, speed, slip, yaw_rate, steering):
        def at(values, where):
            return np.interp(where % line.length, line.distance, values)

        courses = line.heading + line.slip
        here = np.interp(station % line.track_length, line.station, line.distance)
        for _ in range(3):
            course = at(courses, here)
            away_x, away_y = x - at(line.x, here), y - at(line.y, here)
            here = here + away_x * np.cos(course) + away_y * np.sin(course)
        offset = away_y * np.cos(course) - away_x * np.sin(course)
        error = (heading + slip - course + np.pi) % (2 * np.pi) - np.pi
        step = speed * self.time_step
        return np.stack([
            offset, error, speed, yaw_rate, steering, at(line.curvature, here + LEAD * step), at(line.speed, here + LEAD_V * step),
            at(line.acceleration, here + LEAD_A * step),
        ], axis=1)


@dataclass(frozen=True)
class LineDriver:
    car: SingleTrack

    def __call__(self, observation: Tensor) -> Tensor:
        see, car = Sight(*observation.double().unbind(-1)), self.car
        grip = car.friction * GRAVITY
        sight = (SIGHT * see.speed).clamp(min=NEAREST * car.length)
        back = -2 / sight.square() * (see.offset.clamp(-APPROACH * sight, APPROACH * sight) + sight * see.course.sin())
        most = (USED * grip / see.speed.square().clamp(min=1e-6))
        curvature = (see.curvature + back).clamp(-most, most)
        across = see.speed.square() * curvature
        held = torch.maximum(across.abs(), (see.speed * see.yaw_rate).abs())
        along = ((USED * grip) ** 2 - held.square()).clamp(min=0).sqrt()
        drive = (see.acceleration + PACE_GAIN * (see.pace - see.speed)).clamp(-along, along)
        turning = car.wheelbase * curvature + self._understeer(across, drive.clamp(max=see.acceleration.clamp(min=0)))
        angle = turning + DAMP * (see.speed * curvature - see.yaw_rate)
        return torch.stack([self._steer(angle, see), *self._pedals(drive, see)], dim=-1).clamp(-1, 1).float()

    def _understeer(self, across: Tensor, along: Tensor) -> Tensor:
        """By how much the front tyres slip more than the rear ones at these accelerations, [B], rad."""
        car, grip = self.car, self.car.friction * GRAVITY
        left = (1 - (along / grip).square()).clamp(min=0.04).sqrt()
        moved = along * car.height / (GRAVITY * car.wheelbase)
        slips = []
        for arm, load, stiffness in ((car.rear_axle, -moved, car.front_stiffness), (car.front_axle, moved, car.rear_stiffness)):
            share = arm / car.wheelbase
            used = (across / (grip * left) * share / (share + load)).clamp(-0.95, 0.95)
            slips.append(used.sign() * 3 * (1 - (1 - used.abs()) ** (1 / 3)) * left / stiffness)
        return slips[0] - slips[1]

    def _steer(self, angle: Tensor, see: Sight) -> Tensor:
        car = self.car
        if car.steering == "rate":
            return (angle - see.wheels) / (car.steering_rate * car.time_step)
        return angle / (car.max_steering if car.steering == "servo" else car.steering_range(see.speed))

    def _pedals(self, drive: Tensor, see: Sight) -> list[Tensor]:
        car = self.car
        push = drive / car.max_acceleration
        if car.pedals == "one":
            return [push]
        if car.pedals == "two":
            return [2 * push.clamp(min=0) - 1, 2 * (-push).clamp(min=0) - 1]
        return [see.pace / car.max_speed]
