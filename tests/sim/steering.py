"""The paper's three actions as controls of a car that steers, and what a step of it brings."""

from torch import Tensor

from carrl.sim.simulator import Outcome
from carrl.task.action import steer3

ACTIONS = FORWARD, LEFT, RIGHT = range(3)


def steer(actions: Tensor) -> Tensor:
    """Actions [B] to controls [B, 1]."""
    return steer3().controls(actions)


def tensors(outcome: Outcome) -> list[Tensor]:
    """All of it: state, next gate, gates since the start, track; ranges, collisions, gates of the step."""
    return [*vars(outcome.cars).values(), outcome.ranges, outcome.collided, outcome.gates_passed]
