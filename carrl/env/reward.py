"""The paper's reward, term by term, and one of our own for smooth driving.

Shapes: `B` cars.

Source: "Simulation-based Self-driving Car using Reinforcement Learning", section IV.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.sim.vehicle import Action

TERMS = ("collision", "proximity", "gate", "steering")
"""The order of the terms in every tensor of them; the paper has all but the last."""


@dataclass(frozen=True)
class Reward:
    """What a step earns.

    Attributes:
        collision: for touching a wall.
        proximity: for any sensor reading below `proximity_threshold`; not on top of a collision.
        gate: for each gate passed.
        proximity_threshold: as a share of the sensor's range, 0..1.
        turn: for each action left or right; not the paper's.
        switch: for each change between forward and a turn, two of which make left of right; not the paper's.
    """

    collision: float = -200.0
    proximity: float = -20.0
    gate: float = 50.0
    proximity_threshold: float = 0.1
    turn: float = 0.0
    switch: float = 0.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a value that is no finite number."""
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise ConfigError(f"reward.{name} is {value}; it must be a finite number")

    def is_near_wall(self, readings: Tensor) -> Tensor:
        """Whether any sensor reads below the threshold: [B, R] in 0..1 to [B] bool."""
        return readings.amin(dim=-1) < self.proximity_threshold

    def terms(
        self, readings: Tensor, collided: Tensor, gates_passed: Tensor, action: Tensor, last_action: Tensor
    ) -> Tensor:
        """The reward of a step, split into `TERMS`; the reward is their sum.

        Args:
            readings: of the sensors after the step, [B, R], in 0..1.
            collided: [B], bool.
            gates_passed: in this step, [B], int64.
            action: that the step was made with, [B], int64.
            last_action: the one before, [B], int64.

        Returns:
            [B, 4], float32.
        """
        near = self.is_near_wall(readings) & ~collided
        paper = collided * self.collision, near * self.proximity, gates_passed * self.gate
        return torch.stack([*paper, self._steering(action, last_action)], dim=-1).to(readings.dtype)

    @staticmethod
    def of_paper(terms: Tensor) -> Tensor:
        """The sum of the paper's terms: [..., 4] to [...]."""
        return terms[..., :-1].sum(dim=-1)

    @staticmethod
    def of_steering(terms: Tensor) -> Tensor:
        """What the paper's terms leave: [..., 4] to [...]."""
        return terms[..., -1]

    def _steering(self, action: Tensor, last_action: Tensor) -> Tensor:
        if not self.turn and not self.switch:
            return torch.zeros(action.shape, device=action.device)
        steer, last_steer = _steer(action), _steer(last_action)
        return self.turn * steer.abs() + self.switch * (steer - last_steer).abs()


def _steer(action: Tensor) -> Tensor:
    """1 for left, 0 for forward, -1 for right."""
    return (action == Action.LEFT).int() - (action == Action.RIGHT).int()
