"""Vehicles that only the tests have."""

import torch
from torch import Tensor

from carrl.sim.vehicle import POSE, Vehicle


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
