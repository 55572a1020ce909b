"""The paper's three actions as controls of a car that steers, and what a step of it brings."""

from torch import Tensor

from carrl.sim.simulator import CarState, Outcome
from carrl.task.action import steer3

ACTIONS = FORWARD, LEFT, RIGHT = range(3)


def steer(actions: Tensor) -> Tensor:
    """Actions [B] to controls [B, 1]."""
    return steer3().controls(actions)


def tensors(outcome: Outcome) -> list[Tensor]:
    """All of it: state, next gate, gates since the start, track; ranges, collisions, gates of the step."""
    return [*tensors_of(outcome.cars), outcome.ranges, outcome.collided, outcome.gates_passed]


def tensors_of(cars: CarState) -> list[Tensor]:
    """All of the cars' state that is kept."""
    return [values for values in vars(cars).values() if values is not None]
