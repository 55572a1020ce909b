"""The kinematic bicycle with a speed of its own: wheels that roll where they point, within the limit of grip.

Shapes: `N` cars, `S` entries of the state, `C` controls. Lengths are in metres, angles in radians, counter-clockwise
and to the left positive.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.sim.driven import GRAVITY, LEAST_RANGE, PEDALS, RANGE_LATERAL, RANGE_SLIP, DrivenCar
from carrl.sim.vehicle import Kernel

STEERING = "angle", "rate"
"""What the driver sets: the angle of the front wheels, or how fast they turn."""


@dataclass(frozen=True)
class Kinematic(DrivenCar):
    """A bicycle whose tyres do not slip until they slide: the front axle then slides outwards (it understeers).

    The curvature of its way is that of the steering angle, but at most friction * 9.81 / speed^2. Braking and driving
    take nothing of that. Each step is one arc, with the speed and the steering angle of its middle; steering angle and
    speed change evenly over the step. A braking car stops and stays; there is no reverse gear.

    Attributes:
        steering: `angle`: the control is a share of the steering range, which narrows with the speed, and the wheels
            turn there as fast as they can; `rate`: a share of how fast they turn.
        pedals: `one`: drives where it is positive, brakes where it is negative; `two`: throttle and brake, each
            released at -1 and down at 1.
        time_step: simulated time of one step, s.
        length: of the body, about the centre of gravity, m.
        width: of the body, m.
        wheelbase: between the axles, m.
        rear_axle: from the centre of gravity to the rear axle, m.
        max_steering: how far the front wheels turn to either side, rad.
        steering_rate: how fast they turn at most, rad/s.
        max_speed: m/s.
        max_acceleration: m/s^2.
        max_braking: m/s^2.
        friction: greatest lateral acceleration, in multiples of 9.81 m/s^2.

    Source: Rajamani, "Vehicle Dynamics and Control" (2012), section 2.2.
    """

    choices = {"steering": STEERING, "pedals": PEDALS}  # noqa: RUF012 (nobody changes it)

    steering: str = "angle"
    pedals: str = "one"
    time_step: float = 0.1
    length: float = 4.508
    width: float = 1.61
    wheelbase: float = 2.579
    rear_axle: float = 1.423
    max_steering: float = 1.066
    steering_rate: float = 0.8
    max_speed: float = 50.8
    max_acceleration: float = 5.0
    max_braking: float = 10.0
    friction: float = 1.0489

    def __post_init__(self) -> None:
        """Raises ConfigError unless every number is positive, and the wheels turn by less than a right angle."""
        super().__post_init__()
        if self.max_steering >= math.pi / 2:
            raise ConfigError(f"vehicle.max_steering is {self.max_steering}; it must be less than 1.57 rad")
        if self.rear_axle >= self.wheelbase:
            raise ConfigError(f"vehicle.rear_axle is {self.rear_axle}; it must be less than the wheelbase")

    @property
    def kernel(self) -> Kernel:
        """The same on the CPU."""
        from carrl.sim.kinematic_kernel import drive_kinematic  # Here, since Numba takes half a second to import.

        return drive_kinematic

    @property
    def constants(self) -> tuple[float, ...]:
        """In the order in which the kernel takes them."""
        return (
            float(self.steering == "angle"),
            self.time_step,
            self.wheelbase,
            self.rear_axle,
            self.max_steering,
            self.steering_rate,
            self.max_speed,
            self.max_acceleration,
            self.max_braking,
            self.friction * GRAVITY,
            LEAST_RANGE,
            RANGE_LATERAL,
            RANGE_SLIP,
        )

    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """One arc."""
        x, y, heading, speed, _, _, steering, _, _ = state.double().unbind(-1)
        steer, *pedals = control.double().unbind(-1)
        acceleration = self._acceleration(*pedals)
        new_steering = self._turned(steering, steer, speed)
        new_speed = (speed + acceleration * self.time_step).clamp(0, self.max_speed)
        way = (speed + new_speed) / 2 * self.time_step
        curvature, slip = self._curvature((steering + new_steering) / 2, way / self.time_step)
        half_turn = way * curvature / 2
        chord, direction = way * torch.sinc(half_turn / math.pi), heading + slip + half_turn
        new_curvature, new_slip = self._curvature(new_steering, new_speed)
        motion = [
            x + chord * direction.cos(),
            y + chord * direction.sin(),
            torch.remainder(heading + 2 * half_turn + math.pi, 2 * math.pi) - math.pi,
            new_speed,
            new_speed * new_curvature,
            new_slip,
            new_steering,
            (new_speed - speed) / self.time_step,
            (way / self.time_step).square() * curvature,
        ]
        return torch.stack(motion, dim=-1).to(state)

    def _acceleration(self, *pedals: Tensor) -> Tensor:
        """What the pedals ask for, [N], m/s^2."""
        if self.pedals == "one":
            drive, brake = pedals[0].clamp(min=0), -pedals[0].clamp(max=0)
        else:
            drive, brake = ((pedal + 1) / 2 for pedal in pedals)
        return drive * self.max_acceleration - brake * self.max_braking

    def _turned(self, steering: Tensor, steer: Tensor, speed: Tensor) -> Tensor:
        """The angle of the front wheels after the step, [N], rad."""
        most = self.steering_rate * self.time_step
        if self.steering == "angle":
            return steering + (steer * self.steering_range(speed) - steering).clamp(-most, most)
        return (steering + steer * most).clamp(-self.max_steering, self.max_steering)

    def _curvature(self, steering: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Of the way of the centre of gravity, [N], 1/m, and its direction against the heading, [N], rad."""
        rear_curvature = steering.tan() / self.wheelbase
        most = self.friction * GRAVITY / speed.square()
        curvature = rear_curvature / (1 + (self.rear_axle * rear_curvature).square()).sqrt()
        curvature = torch.maximum(torch.minimum(curvature, most), -most)
        return curvature, (self.rear_axle * curvature).asin()
