"""What moves along the road: its states, controls and limits, for the optimal control problem.

A model's motion begins with x, y and heading, m and rad; the rest is its own. A control is constant from one station to
the next. Units: m, s, rad.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from carrl.racing.equations import RATES, Expression, casadi
from carrl.sim.driven import GRAVITY, LEAST_RANGE, RANGE_LATERAL, RANGE_SLIP
from carrl.sim.single_track import SingleTrack
from carrl.sim.tyres import EASE, STEERABLE

MOST_SLIP = 1.2
"""rad, or across by along: a car that slides further is not looked for."""
MOST_TURN = 1.5
"""rad, of the heading against the road's."""


@dataclass(frozen=True)
class Range:
    """What a state or a control may be, and how large it typically is.

    Attributes:
        low: the least value.
        high: the greatest.
        scale: by which the solver divides it.
    """

    low: float
    high: float
    scale: float


class LapModel(ABC):
    """What the problem needs to know.

    Attributes:
        car: whose lap it is.
        smoothed: the control whose square, in shares of its greatest value, is weighed a little beside the time; None
            for none.
    """

    car: SingleTrack
    smoothed: ClassVar[int | None] = None

    @property
    @abstractmethod
    def states(self) -> tuple[Range, ...]:
        """Of the motion's entries beyond x, y and heading."""

    @property
    @abstractmethod
    def controls(self) -> tuple[Range, ...]:
        """Of each control."""

    @property
    @abstractmethod
    def body(self) -> tuple[float, ...]:
        """How far ahead of the middle those points of its sides are that must stay between the walls, m."""

    @abstractmethod
    def rates(self, motion: Sequence[Expression], control: Sequence[Expression]) -> list[Expression]:
        """What changes of the motion, a second."""

    @abstractmethod
    def limits(
        self, before: Sequence[Expression], middle: Sequence[Expression], control: Sequence[Expression]
    ) -> list[Expression]:
        """What must not exceed 0, by the motion at a station and that half-way to the next."""


@dataclass(frozen=True)
class PointMass(LapModel):
    """A mass whose acceleration has a limit in any direction, and an engine with a power.

    Its states are the speed; its controls the shares of the grip that it uses along and across its way.
    """

    car: SingleTrack

    @property
    def grip(self) -> float:
        """Greatest acceleration, m/s^2."""
        return self.car.friction * GRAVITY

    @property
    def states(self) -> tuple[Range, ...]:
        """The speed."""
        return (Range(_least_speed(self.car), self.car.max_speed, self.car.max_speed / 2),)

    @property
    def controls(self) -> tuple[Range, ...]:
        """Shares of the grip along and across the way."""
        strongest = self.car.max_acceleration / self.grip
        return Range(-min(1.0, strongest), min(1.0, strongest), 1.0), Range(-1.0, 1.0, 1.0)

    @property
    def body(self) -> tuple[float, ...]:
        """As wide as the car."""
        return (0.0,)

    def rates(self, motion: Sequence[Expression], control: Sequence[Expression]) -> list[Expression]:
        """The heading is that of the way."""
        ca = casadi()
        _, _, heading, speed = motion
        along, across = control
        return [speed * ca.cos(heading), speed * ca.sin(heading), self.grip * across / speed, self.grip * along]

    def limits(
        self, before: Sequence[Expression], middle: Sequence[Expression], control: Sequence[Expression]
    ) -> list[Expression]:
        """Grip and power."""
        along, across = control
        power = self.car.max_acceleration * self.car.power_speed
        return [along**2 + across**2 - 1, self.grip * along * middle[3] / power - 1]


@dataclass(frozen=True)
class Car(LapModel):
    """The single-track car of the simulator.

    Its states are the two that say how the centre of gravity moves, the yaw rate and the steering angle; its controls
    how fast the wheels turn, and the acceleration asked of engine and brakes, which is never more than they give.
    """

    car: SingleTrack
    smoothed = 0

    @property
    def has_brush_tyres(self) -> bool:
        """Or linear ones."""
        return self.car.tyre == "brush"

    @property
    def states(self) -> tuple[Range, ...]:
        """Speeds along and across, or speed and slip; yaw rate; steering angle."""
        car, fast = self.car, self.car.max_speed
        spin = 5 * GRAVITY * max(1.0, car.friction) / _least_speed(car)
        moving = Range(_least_speed(car), fast, fast / 2)
        sliding = Range(-fast, fast, fast / 20) if self.has_brush_tyres else Range(-MOST_SLIP, MOST_SLIP, 0.1)
        return moving, sliding, Range(-spin, spin, 2 * GRAVITY / fast), Range(-car.max_steering, car.max_steering, 0.1)

    @property
    def controls(self) -> tuple[Range, ...]:
        """Of the wheels, rad/s, and of engine and brakes, m/s^2."""
        car, grip = self.car, self.car.friction * GRAVITY
        strongest = car.max_acceleration
        if self.has_brush_tyres:
            strongest = min(strongest, (1 - STEERABLE**2) ** 0.5 * grip)
        return Range(-car.steering_rate, car.steering_rate, car.steering_rate), Range(-strongest, strongest, grip)

    @property
    def body(self) -> tuple[float, ...]:
        """Its corners and the middles of its sides."""
        return self.car.length / 2, 0.0, -self.car.length / 2

    def rates(self, motion: Sequence[Expression], control: Sequence[Expression]) -> list[Expression]:
        """The simulator's."""
        return [*RATES[self.car.tyre](self.car, motion[:6], motion[6], control[1]), control[0]]

    def limits(
        self, before: Sequence[Expression], middle: Sequence[Expression], control: Sequence[Expression]
    ) -> list[Expression]:
        """Power, full speed, slip, and how far the driver of `steering=angle` turns the wheels at a speed."""
        ca, car, drive = casadi(), self.car, control[1]
        limits = [drive * middle[3] / (car.max_acceleration * car.power_speed) - 1]
        if self.has_brush_tyres:
            energy, full = middle[3] ** 2 + middle[4] ** 2, car.max_speed
            limits.append((drive - EASE / (2 * full) * (full**2 - energy)) / (car.friction * GRAVITY))
            limits += [(sign * middle[4] - MOST_SLIP * middle[3]) / full for sign in (1, -1)]
        if car.steering == "angle":
            energy = before[3] ** 2 + (before[4] ** 2 if self.has_brush_tyres else 0)
            widest = ca.fmax(car.wheelbase * RANGE_LATERAL / energy + RANGE_SLIP, LEAST_RANGE * car.max_steering)
            limits += [sign * before[6] - widest for sign in (1, -1)]
        return limits


def _least_speed(car: SingleTrack) -> float:
    """From which on the equations are the simulator's, m/s: brakes do not ease off, linear tyres slip."""
    easing = car.max_acceleration / EASE
    return max(easing, car.kinematic_below) if car.tyre == "linear" else easing
