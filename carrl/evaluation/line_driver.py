"""A driver that knows the map: it follows a minimum lap with less grip, weaker brakes and some distance to the walls.

The lap is a point mass's, found in seconds; how to turn the wheels for its way is told by the tyres of the car.

Shapes: `B` cars, `C` controls. Units: m, s, rad; angles to the left positive.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.evaluation.rollout import Policy
from carrl.racing.cross_sections import CrossSections, Floats
from carrl.racing.kept_laps import kept_lap
from carrl.racing.reference_line import ReferenceLine
from carrl.sim.driven import GRAVITY
from carrl.sim.sensor import Sensor
from carrl.sim.single_track import SingleTrack
from carrl.sim.tyres import FULL_SLIP, STEERABLE
from carrl.task.action import ActionMap, ContinuousActions
from carrl.task.episode import ObservationContext
from carrl.task.motion import WIDE
from carrl.task.observation import Observation, Part
from carrl.task.road import RoadTerm
from carrl.task.task import World
from carrl.tracks.track import Track

GRIP, BRAKING, MARGIN = 0.7, 0.5, 0.6
"""Of the line: shares of the car's grip that it uses at all and for brakes, and how far it keeps from walls, in widths
of the car, where the road has room for it."""
SIGHT, NEAREST, APPROACH = 0.8, 2.0, 0.2
"""The way back to the line is an arc that meets it so many seconds ahead, but not nearer than these lengths of the car;
and begins at this slope at most."""
WHEELS, PEDALS = 0.12, 0.5
"""How far ahead the line counts: for the wheels half a step and the time in which they turn by so much, rad; for the
pedals so many steps."""
DAMPING = 0.033
"""Of the wheels against the yaw rate that is not wanted, s for each metre of the car's length."""
PACE_GAIN = 2.0
"""Of the pedals, 1/s."""
MOST_USED = 0.85
"""Brakes and engine leave so much of the grip to the wheels, whatever the line says."""


class Sight(NamedTuple):
    """What the driver sees, [B] each.

    Attributes:
        offset: of the car from the line, to the left, m.
        course: the direction of its way against that of the line, rad.
        speed: m/s.
        yaw_rate: rad/s.
        steering: angle of the front wheels, rad.
        curvature: of the line ahead, 1/m.
        pace: the line's speed ahead, m/s.
        acceleration: the line's ahead, m/s^2.
    """

    offset: Tensor
    course: Tensor
    speed: Tensor
    yaw_rate: Tensor
    steering: Tensor
    curvature: Tensor
    pace: Tensor
    acceleration: Tensor


def line_driver_of(world: World, tracks: Sequence[Track]) -> tuple[World, Policy]:
    """The driver for a world's car: the world as it sees it on these tracks, and what it does there.

    Raises:
        CarrlError: the driver knows no such car, or a line was not found.
    """
    car = world.vehicle
    if type(car) is not SingleTrack or car.tyre == "linear" or car.steering == "servo" or car.pedals == "speed":
        raise ConfigError(
            "the line is driven by a car with brush tyres, of which its driver sets the steering angle or rate and the "
            "pedals; choose vehicle=single_track, whose preset is race"
        )
    sees = Observation({"line": LineAhead(car, {track: careful_line(track, car) for track in tracks})})
    return replace(world, observation=sees, action=ContinuousActions(car.control_names)), LineDriver(car)


def careful_line(track: Track, car: SingleTrack) -> ReferenceLine:
    """The minimum lap of a point mass with less grip and weaker brakes than a car, but its power; from the cache.

    Raises:
        CarrlError: it was not found, or the car does not fit the road.
    """
    strongest = min(car.max_acceleration, BRAKING * car.friction * GRAVITY)
    power_speed = car.power_speed * car.max_acceleration / strongest
    careful = replace(
        car,
        friction=GRIP * car.friction,
        max_acceleration=strongest,
        power_speed=power_speed,
    )
    room = float(CrossSections.of(track, car.length, car.length).width.min()) - car.width
    return kept_lap(track, careful, margin=min(MARGIN * car.width, max(0.0, room / 4)), quick=True).line.closed()


@dataclass(frozen=True)
class LineAhead(RoadTerm):
    """A `Sight` of the line of the track that a car drives on.

    Attributes:
        car: that drives.
        lines: closed ones, of each track.
    """

    car: SingleTrack
    lines: Mapping[Track, ReferenceLine]

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """The values of a `Sight`."""
        return Part(name, len(Sight._fields), -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        """In their order."""
        names = ("x", "y", "heading", "slip", "speed", "yaw_rate", "steering")
        values = [self._place(context).station, *(context.value(name) for name in names)]
        columns = torch.stack(values).double().numpy()
        seen, tracks = np.empty((len(Sight._fields), columns.shape[1])), context.state.cars.track.numpy()
        for index in np.unique(tracks):
            seen[:, tracks == index] = self._sight(
                self.lines[context.simulator.tracks[index]], columns[:, tracks == index]
            )
        return torch.from_numpy(seen.T).float()

    def _sight(self, line: ReferenceLine, cars: Floats) -> Floats:
        """Of cars on the same track, of the station on its centreline and their states."""
        station, x, y, heading, slip, speed, yaw_rate, steering = cars

        def at(values: Floats, distance: Floats) -> Floats:
            return np.interp(distance % line.length, line.distance, values)

        here = np.interp(station % line.track_length, line.station, line.distance)
        for _ in range(3):  # Newton's steps to the nearest place of the line
            course = at(line.heading + line.slip, here)
            ahead, aside = x - at(line.x, here), y - at(line.y, here)
            here = here + ahead * np.cos(course) + aside * np.sin(course)
        offset = aside * np.cos(course) - ahead * np.sin(course)
        against = (heading + slip - course + np.pi) % (2 * np.pi) - np.pi
        step = self.car.time_step
        wheels, pedals = (here + speed * lead for lead in (step / 2 + WHEELS / self.car.steering_rate, PEDALS * step))
        ways = at(line.curvature, wheels), at(line.speed, pedals), at(line.acceleration, pedals)
        return np.stack([offset, against, speed, yaw_rate, steering, *ways])


@dataclass(frozen=True)
class LineDriver:
    """Steers for the line's curvature and an arc back to it, by the slip that the tyres need, and keeps its speed.

    Attributes:
        car: that drives.

    Source: Kapania and Gerdes 2015, "Design of a feedback-feedforward steering controller for accurate path tracking
    and stability at the limits of handling", for the feedforward with the slip of the tyres; Coulter 1992,
    "Implementation of the Pure Pursuit Path Tracking Algorithm", for the arc.
    """

    car: SingleTrack

    def __call__(self, observation: Tensor) -> Tensor:
        """The controls [B, C], of a `Sight` [B, 8]."""
        see, car = Sight(*observation.double().unbind(-1)), self.car
        most = MOST_USED * car.friction * GRAVITY
        sight = (SIGHT * see.speed).clamp(min=NEAREST * car.length)
        aside = see.offset.clamp(-APPROACH * sight, APPROACH * sight) + sight * see.course.sin()
        tightest = most / see.speed.square().clamp(min=1e-6)
        curvature = (see.curvature - 2 * aside / sight.square()).clamp(-tightest, tightest)
        across = see.speed.square() * curvature
        turning = torch.maximum(across.abs(), (see.speed * see.yaw_rate).abs())
        strongest = (most**2 - turning.square()).clamp(min=0).sqrt()
        drive = (see.acceleration + PACE_GAIN * (see.pace - see.speed)).clamp(-strongest, strongest)
        understeer = self._understeer(across, drive.minimum(see.acceleration.clamp(min=0)))
        damping = DAMPING * car.length * (see.speed * curvature - see.yaw_rate)
        angle = car.wheelbase * curvature + understeer + damping
        return torch.stack([self._wheel(angle, see), *self._pedals(drive, see.speed)], dim=-1).clamp(-1, 1).float()

    def _understeer(self, across: Tensor, along: Tensor) -> Tensor:
        """By how much tyres slip more in front than behind at these accelerations [B], m/s^2: [B], rad."""
        car, grip = self.car, self.car.friction * GRAVITY
        left = (1 - (along / grip).square()).clamp(min=STEERABLE**2).sqrt()
        moved = along * car.height / (GRAVITY * car.wheelbase)
        front, rear = (
            self._slip(across / (grip * left) * share / (share + load)) * left / stiffness
            for share, load, stiffness in (
                (car.rear_axle / car.wheelbase, -moved, car.front_stiffness),
                (car.front_axle / car.wheelbase, moved, car.rear_stiffness),
            )
        )
        return front - rear

    @staticmethod
    def _slip(used: Tensor) -> Tensor:
        """The slip, in stiffnesses, at which brush tyres use this share of their grip, [B]: `Brush.force` solved."""
        return used.sign() * FULL_SLIP * (1 - (1 - used.abs().clamp(max=0.95)) ** (1 / 3))

    def _wheel(self, angle: Tensor, see: Sight) -> Tensor:
        """The control that turns the front wheels to an angle [B], rad."""
        car = self.car
        if car.steering == "rate":
            return (angle - see.steering) / (car.steering_rate * car.time_step)
        return angle / car.steering_range(see.speed)

    def _pedals(self, drive: Tensor, speed: Tensor) -> list[Tensor]:
        """The controls that give an acceleration [B], m/s^2."""
        push = (drive / self.car.max_acceleration).clamp(-1, 1)
        if self.car.pedals == "two":
            return [2 * push.clamp(min=0) - 1, -2 * push.clamp(max=0) - 1]
        if self.car.pedals == "power":
            push = torch.where(push > 0, push * (speed / self.car.power_speed).clamp(min=1), push)
        return [push]
