"""What the driver is told: its sensors, and if it is to drive smoothly, what it did last.

Shapes: `B` cars, `R` rays.
"""

import torch
from torch import Tensor

from carrl.sim.vehicle import Action

FIRST_ACTION = Action.FORWARD
"""What counts as the action before the first one of an episode."""


def observation_size(rays: int, observe_action: bool) -> int:
    """How many values an observation has."""
    return rays + len(Action) * observe_action


def observe(readings: Tensor, last_action: Tensor, observe_action: bool) -> Tensor:
    """The observation, [B, R], or with `observe_action` [B, R + 3], all in 0..1.

    Args:
        readings: distance along each ray / range, [B, R], float32, right to left.
        last_action: values of `Action`, [B], int64.
        observe_action: append the last action, one-hot.
    """
    if not observe_action:
        return readings
    one_hot = last_action[:, None] == torch.arange(len(Action), device=last_action.device)
    return torch.cat([readings, one_hot.to(readings.dtype)], dim=-1)
