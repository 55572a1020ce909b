"""Vehicles that only the tests have."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.sim.vehicle import POSE, Rectangle, Vehicle, VehicleModel


class Interpreted(Vehicle):
    """The paper's car without machine code."""

    @property
    def kernel(self) -> None:
        """None."""
        return None


class Odometer(Interpreted):
    """The same, with the way driven since the start of the episode, m, as a fourth entry of its state."""

    state_names = (*POSE, "driven")

    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """Adds the way of the step."""
        return torch.cat([super().step(state, control), state[:, 3:] + self.step_length], dim=-1)


MOTION = ("speed", "yaw_rate", "slip", "steering", "acceleration", "lateral_acceleration")


@dataclass(frozen=True)
class Cart(VehicleModel):
    """A rectangle with pedals that turns about its middle: what displays need to know of a car whose speed varies."""

    state_names = (*POSE, *MOTION)
    control_names = ("steer", "pedal")
    time_step: float = 0.1
    top_speed: float = 20.0

    @property
    def body(self) -> Rectangle:
        """4 m long, 1.6 m wide."""
        return Rectangle(4.0, 1.6)

    @property
    def step_length(self) -> float:
        """At its top speed."""
        return self.top_speed * self.time_step

    def initial_state(self, pose: Tensor, speed: Tensor | None = None) -> Tensor:
        """At rest, unless it is told a speed."""
        state = torch.nn.functional.pad(pose, (0, len(MOTION)))
        if speed is not None:
            state[:, 3] = speed
        return state

    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """Pedals change the speed, the wheel stands at up to 0.4 rad, 2.5 m between the axles."""
        before, steering = state[:, 3], 0.4 * control[:, 0]
        speed = (before + 4.0 * control[:, 1] * self.time_step).clamp(0, self.top_speed)
        yaw_rate = speed * steering.tan() / 2.5
        heading = state[:, 2] + yaw_rate * self.time_step
        way = speed * self.time_step
        x, y = state[:, 0] + way * heading.cos(), state[:, 1] + way * heading.sin()
        heading = torch.remainder(heading + math.pi, 2 * math.pi) - math.pi
        ahead, aside = (speed - before) / self.time_step, speed * yaw_rate
        return torch.stack([x, y, heading, speed, yaw_rate, 0 * speed, steering, ahead, aside], dim=-1)
