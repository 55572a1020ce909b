"""The paper's three actions as controls of a car that steers."""

from torch import Tensor

from carrl.env.action import steer3

ACTIONS = FORWARD, LEFT, RIGHT = range(3)


def steer(actions: Tensor) -> Tensor:
    """Actions [B] to controls [B, 1]."""
    return steer3().controls(actions)
