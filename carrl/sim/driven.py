"""What cars that are steered, driven and braked have in common: their state, their controls and their body.

Shapes: `N` cars, `S` entries of the state, `C` controls. Lengths are in metres, angles in radians, counter-clockwise
and to the left positive.
"""

import math
from collections.abc import Collection, Mapping
from typing import ClassVar

from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.sim.vehicle import POSE, Rectangle, VehicleModel

MOTION = (*POSE, "speed", "yaw_rate", "slip", "steering", "acceleration", "lateral_acceleration")
"""What the state of every such car begins with: where its centre of gravity is, m, and the heading, rad; the speed of
the centre of gravity, m/s; rad/s; the direction of the speed against the heading, rad; the angle of the front wheels,
rad; and the mean accelerations along and across the car over the last step, m/s^2, 0 at a start."""
GRAVITY = 9.81
"""m/s^2."""
PEDALS: Mapping[str, tuple[str, ...]] = {"one": ("pedal",), "two": ("throttle", "brake")}
"""Names of the controls: one pedal drives where it is positive and brakes where it is negative; of two, each is
released at -1 and down at 1."""
LEAST_RANGE, RANGE_LATERAL, RANGE_SLIP = 0.2, 25.0, 0.07
"""Of the speed-scaled steering range: a share of the lock, m/s^2 and rad."""


class DrivenCar(VehicleModel):
    """A car with a speed of its own.

    Attributes:
        pedals: which ones there are, of `PEDALS`.
        length: of the body, about the centre of gravity, m.
        width: of the body, m.
        wheelbase: between the axles, m.
        rear_axle: from the centre of gravity to the rear axle, m.
        max_steering: how far the front wheels turn to either side, rad.
        max_speed: m/s.
    """

    state_names = MOTION
    choices: ClassVar[Mapping[str, Collection[str]]]
    """What each parameter that is a word may be."""
    pedals: str
    length: float
    width: float
    wheelbase: float
    rear_axle: float
    max_steering: float
    max_speed: float

    def __post_init__(self) -> None:
        """Raises ConfigError unless every word stands for something and every number is positive."""
        for name, allowed in self.choices.items():
            if getattr(self, name) not in allowed:
                raise ConfigError(f"vehicle.{name} is {shown(getattr(self, name))}; it must be {' or '.join(allowed)}")
        self._check_positive(name for name in vars(self) if name not in self.choices)

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Steering wheel, then pedals."""
        return "steer", *PEDALS[self.pedals]

    @property
    def step_length(self) -> float:
        """At full speed, m."""
        return self.max_speed * self.time_step

    @property
    def body(self) -> Rectangle:
        """Its middle is the centre of gravity."""
        return Rectangle(self.length, self.width)

    @property
    def body_radius(self) -> float:  # type: ignore[override]
        """Half the width, m: of the disc that stands for the body in pictures."""
        return self.width / 2

    @property
    def turn_radius(self) -> float:
        """Of the tightest circle that the centre of gravity drives, slowly, m."""
        return math.hypot(self.wheelbase / math.tan(self.max_steering), self.rear_axle)

    def initial_state(self, pose: Tensor, speed: Tensor | None = None) -> Tensor:
        """The states [N, S] of cars that an episode starts at these poses [N, 3], straight on and at this speed [N].

        Raises:
            ConfigError: the car does not drive that fast.
        """
        for wrong in [] if speed is None else speed[~((speed >= 0) & (speed <= self.max_speed))].tolist()[:1]:
            raise ConfigError(f"start.speed is {wrong:g} m/s; it must lie between 0 and the car's {self.max_speed:g}")
        return super().initial_state(pose, speed)

    def steering_range(self, speed: Tensor) -> Tensor:
        """How far the driver turns the front wheels at most at a speed, so that it is never violent: [N], rad.

        Source: open-racing (2026): the angle of a turn with 25 m/s^2 to the side, and 0.07 rad for the tyres' slip.
        """
        angle = self.wheelbase * RANGE_LATERAL / speed.square() + RANGE_SLIP
        return angle.clamp(min=LEAST_RANGE * self.max_steering, max=self.max_steering)
