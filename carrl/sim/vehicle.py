"""Vehicle models: a named state, named controls, and how one step leads from one state to the next.

A model states its motion twice: `step` in torch, for any device and as the definition, and `kernel`, optional, the same
for the CPU as machine code. The simulator reads the first three entries of the state, where the car is; all else is
the model's own business.

Shapes: `N` cars, `S` entries of the state, `C` controls. Lengths are in metres, angles in radians counter-clockwise
from +x.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.machine_code import compiled

LEAST, MOST = 1e-9, 1e9
"""Bounds of every parameter of a car, m, m/s, s or degrees; far off, so that none of their products overflows."""
POSE = ("x", "y", "heading")
"""What every state begins with: m, m, rad."""
HULL = 0.95, 0.59
"""How far the car that is drawn for a disc reaches ahead and to the side, in radii."""

Kernel = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""States [N, S], float32, controls [N, C], float32, and the model's constants [K], float64, to the next states."""


@dataclass(frozen=True)
class Disc:
    """A body that is the same from all sides.

    Attributes:
        radius: m.
    """

    by_corners: ClassVar[bool] = False
    radius: float

    @property
    def half_width(self) -> float:
        """From the middle of the car to its side, m."""
        return self.radius

    @property
    def reach(self) -> float:
        """From the middle of the car to the point of the body that is furthest off, m."""
        return self.radius

    @property
    def outline(self) -> "Rectangle":
        """What other cars see and touch: the rectangle about the car that is drawn."""
        return Rectangle(2 * HULL[0] * self.radius, 2 * HULL[1] * self.radius)

    @property
    def measures(self) -> tuple[float, float, float]:
        """Radius, half length and half width as the machine code has them, m; 0 for what another body has."""
        return float(self.radius), 0.0, 0.0


@dataclass(frozen=True)
class Rectangle:
    """A body with its middle in that of the car, along the heading.

    Attributes:
        length: along the heading, m.
        width: across it, m.
        by_corners: whether it touches a wall only where, after a step, one of its corners is beyond the wall.
    """

    length: float
    width: float
    by_corners: bool = False

    def __post_init__(self) -> None:
        """Raises ConfigError unless both are positive numbers, neither tiny nor huge."""
        for name, value in (("length", self.length), ("width", self.width)):
            if isinstance(value, bool) or not (isinstance(value, int | float) and LEAST <= value <= MOST):
                raise ConfigError(f"body.{name} is {value}; it must be a number between {LEAST:g} and {MOST:g}")

    @property
    def half_width(self) -> float:
        """From the middle of the car to its side, m."""
        return self.width / 2

    @property
    def half_size(self) -> tuple[float, float]:
        """From the middle of the car to its front and to its side, m."""
        return self.length / 2, self.width / 2

    @property
    def reach(self) -> float:
        """From the middle of the car to a corner, m."""
        return math.hypot(self.length, self.width) / 2

    @property
    def outline(self) -> "Rectangle":
        """What other cars see and touch."""
        return self

    @property
    def measures(self) -> tuple[float, float, float]:
        """Radius, half length and half width as the machine code has them, m; 0 for what another body has."""
        return 0.0, *self.half_size


class VehicleModel(ABC):
    """What all cars have in common.

    Attributes:
        state_names: of the state's entries, beginning with those of `POSE`.
        control_names: of the controls; each lies in [-1, 1].
        time_step: simulated time of one step, s.
        body_radius: radius of the disc that must not touch a wall, m, unless `body` is another one.
    """

    state_names: ClassVar[tuple[str, ...]] = POSE
    control_names: ClassVar[tuple[str, ...]]
    time_step: float
    body_radius: float

    def __post_init__(self) -> None:
        """Raises ConfigError unless every value is a positive number, neither tiny nor huge."""
        self._check_positive(vars(self))

    def _check_positive(self, names: Iterable[str]) -> None:
        for name in names:
            value = getattr(self, name)
            if isinstance(value, bool) or not (isinstance(value, int | float) and 0 < value < math.inf):
                raise ConfigError(f"vehicle.{name} is {value}; it must be a positive number")
            if not LEAST <= value <= MOST:
                raise ConfigError(f"vehicle.{name} is {value}; it must lie between {LEAST:g} and {MOST:g}")

    @property
    def body(self) -> Disc | Rectangle:
        """What must not touch a wall."""
        return Disc(self.body_radius)

    @property
    @abstractmethod
    def step_length(self) -> float:
        """The longest way that a car drives in one step, m."""

    @property
    def kernel(self) -> Kernel | None:
        """`step` as machine code, made by `carrl.sim.vehicle.compiled`; None to run it in torch everywhere."""
        return None

    @property
    def constants(self) -> tuple[float, ...]:
        """What the kernel needs to know of this car, [K]."""
        return ()

    def initial_state(self, pose: Tensor, speed: Tensor | None = None) -> Tensor:
        """The states [N, S] of cars that an episode starts with, zero beyond the pose and the speed.

        Args:
            pose: [N, 3].
            speed: [N], m/s; None for cars at rest. Only a vehicle whose state has a `speed` can be asked for one.
        """
        state = torch.nn.functional.pad(pose, (0, len(self.state_names) - len(POSE)))
        if speed is not None:
            state[:, self.state_names.index("speed")] = speed.to(state)
        return state

    def after_contact(self, state: Tensor, pose: Tensor, direction: Tensor, kept: float) -> Tensor:
        """The states [N, S] of cars that have touched a wall and go on along it.

        Of the velocity remains the component along the wall, if it leads forward; the car neither slips nor turns.

        Args:
            state: after the step, as if there were no wall, [N, S].
            pose: where the wall leaves the car, [N, 3].
            direction: along the wall, the one that is nearer to the heading, [N], rad.
            kept: share of the speed along the wall that is kept.
        """
        names = self.state_names
        if "speed" not in names:
            return self.going_on(state, pose)
        slip = state[:, names.index("slip")] if "slip" in names else torch.zeros_like(direction)
        along = state[:, names.index("speed")] * (state[:, 2] + slip - direction).cos()
        return self.going_on(state, pose, kept * along.clamp(min=0))

    def going_on(self, state: Tensor, pose: Tensor, speed: Tensor | None = None) -> Tensor:
        """The states [N, S] of cars that something in their way has left elsewhere; they neither slip nor turn.

        Args:
            state: after the step, as if there were nothing in their way, [N, S].
            pose: [N, 3].
            speed: [N], m/s; None for cars that have but one.
        """
        after = dict(zip(self.state_names, state.unbind(-1), strict=True))
        if speed is not None:
            if "acceleration" in after:
                after["acceleration"] = after["acceleration"] + (speed - after["speed"]) / self.time_step
            after["speed"] = speed
        for name in ("slip", "yaw_rate", "lateral_acceleration"):
            if name in after:
                after[name] = torch.zeros_like(pose[:, 0])
        return torch.cat([pose, torch.stack(list(after.values()), dim=-1)[:, len(POSE) :]], dim=-1)

    @abstractmethod
    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """Drives one step.

        Args:
            state: named by `state_names`, [N, S].
            control: named by `control_names`, [N, C], in [-1, 1].

        Returns:
            The states one step later, [N, S], heading in [-pi, pi).
        """


class ConstantSpeed(VehicleModel):
    """A car that does nothing but steer: its one control is -1 full right, 0 straight on, 1 full left.

    Attributes:
        speed: m/s, the same in every step.
        time_step: simulated time of one step, s.
    """

    control_names = ("steer",)
    speed: float

    @property
    def step_length(self) -> float:
        """Distance driven in one step along the way, m."""
        return self.speed * self.time_step

    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """At its speed."""
        return self.step_at(state, control, torch.ones_like(state[:, 0]))

    def step_at(self, state: Tensor, control: Tensor, pace: Tensor) -> Tensor:
        """Drives one step at a share of the speed, [N], on the same circles: see `step`.

        Raises:
            ConfigError: the vehicle cannot.
        """
        raise ConfigError(f"a {type(self).__name__} cannot drive slower than it does; it has no step_at")


@compiled
def _turn_then_drive(state: np.ndarray, control: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """What `Vehicle.step` computes, in float32 throughout but for sine and cosine."""
    distance, yaw_per_step = np.float32(constants[0]), np.float32(constants[1])
    moved = np.empty_like(state)
    for car in range(len(state)):
        heading = state[car, 2] + control[car, 0] * yaw_per_step
        moved[car, 0] = state[car, 0] + distance * np.float32(math.cos(np.float64(heading)))
        moved[car, 1] = state[car, 1] + distance * np.float32(math.sin(np.float64(heading)))
        moved[car, 2] = (heading + np.float32(math.pi)) % np.float32(2 * math.pi) - np.float32(math.pi)
    return moved


@dataclass(frozen=True)
class Vehicle(ConstantSpeed):
    """Turns on the spot by up to a fixed angle, then drives straight along its new heading (semi-implicit Euler).

    A car that keeps turning therefore drives a regular polygon with sides of `step_length`.

    Attributes:
        speed: m/s, the same in every step.
        time_step: simulated time of one step, s.
        turn_radius: radius of the circle driven while turning fully, m.
        body_radius: radius of the disc that must not touch a wall, m.
    """

    speed: float = 10.0
    time_step: float = 0.1
    turn_radius: float = 7.2
    body_radius: float = 0.5

    @property
    def yaw_per_step(self) -> float:
        """Change of heading in one step of turning fully, rad."""
        return self.step_length / self.turn_radius

    @property
    def kernel(self) -> Kernel:
        """The same on the CPU."""
        return _turn_then_drive

    @property
    def constants(self) -> tuple[float, ...]:
        """Distance, m, and change of heading, rad, of a step."""
        return self.step_length, self.yaw_per_step

    def step_at(self, state: Tensor, control: Tensor, pace: Tensor) -> Tensor:
        """Turns first, then drives."""
        heading = state[:, 2] + control[:, 0].to(state) * self.yaw_per_step * pace
        return _placed(state, self.step_length * pace, heading, heading)


@compiled
def _drive_an_arc(state: np.ndarray, control: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """What `Bicycle.step` computes: what each control does in float64, the pose in float32."""
    step_length, wheelbase, steering_angle = constants
    moved = np.empty_like(state)
    for car in range(len(state)):
        slip = math.atan(math.tan(np.float64(control[car, 0]) * steering_angle) / 2)
        half_yaw = step_length * math.sin(slip) / wheelbase
        chord = step_length if half_yaw == 0 else step_length * math.sin(half_yaw) / half_yaw
        direction = np.float64(state[car, 2] + np.float32(slip + half_yaw))
        heading = state[car, 2] + np.float32(2 * half_yaw)
        moved[car, 0] = state[car, 0] + np.float32(chord) * np.float32(math.cos(direction))
        moved[car, 1] = state[car, 1] + np.float32(chord) * np.float32(math.sin(direction))
        moved[car, 2] = (heading + np.float32(math.pi)) % np.float32(2 * math.pi) - np.float32(math.pi)
    return moved


@dataclass(frozen=True)
class Bicycle(ConstantSpeed):
    """The kinematic bicycle, seen from half-way between its axles.

    Each step is the exact arc of a circle, with the car's middle sliding along it at an angle to the heading. Only for
    collisions and gates the way is the arc's chord.

    Attributes:
        speed: of the car's middle, m/s, the same in every step.
        time_step: simulated time of one step, s.
        wheelbase: between the axles, m.
        steering_angle: of the front wheel when it is turned fully, degrees.
        body_radius: radius of the disc about the car's middle that must not touch a wall, m.

    Source: Rajamani, "Vehicle Dynamics and Control" (2012), section 2.2.
    """

    speed: float = 10.0
    time_step: float = 0.1
    wheelbase: float = 1.0
    steering_angle: float = 8.0
    body_radius: float = 0.5

    def __post_init__(self) -> None:
        """Raises ConfigError unless every value is a positive number and the wheel can be turned so far."""
        super().__post_init__()
        if self.steering_angle >= 90:
            raise ConfigError(f"vehicle.steering_angle is {self.steering_angle}; it must be less than 90 degrees")

    @property
    def slip_angle(self) -> float:
        """Of the way of the car's middle against its heading, in a full turn to the left, rad."""
        return math.atan(math.tan(math.radians(self.steering_angle)) / 2)

    @property
    def turn_radius(self) -> float:
        """Of the circle that the car's middle drives in a full turn, m."""
        return self.wheelbase / (2 * math.sin(self.slip_angle))

    @property
    def kernel(self) -> Kernel:
        """The same on the CPU."""
        return _drive_an_arc

    @property
    def constants(self) -> tuple[float, ...]:
        """Way of a step, m, wheelbase, m, and steering angle, rad."""
        return self.step_length, self.wheelbase, math.radians(self.steering_angle)

    def step_at(self, state: Tensor, control: Tensor, pace: Tensor) -> Tensor:
        """The chord of the arc."""
        angle, way = control[:, 0].double() * math.radians(self.steering_angle), self.step_length * pace.double()
        slip = (angle.tan() / 2).atan()
        half_yaw = way * slip.sin() / self.wheelbase
        chord = way * torch.sinc(half_yaw / math.pi)
        direction = state[:, 2] + (slip + half_yaw).to(state)
        return _placed(state, chord.to(state), direction, state[:, 2] + (2 * half_yaw).to(state))


def _placed(state: Tensor, distance: Tensor, direction: Tensor, heading: Tensor) -> Tensor:
    """The poses [N, 3] so far from the states [N, S] in this direction [N], with this heading [N]."""
    x, y = state[:, 0] + distance * direction.cos(), state[:, 1] + distance * direction.sin()
    return torch.stack([x, y, torch.remainder(heading + math.pi, 2 * math.pi) - math.pi], dim=-1)
