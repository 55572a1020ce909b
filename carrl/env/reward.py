"""The paper's reward, term by term.

Shapes: `B` cars.

Source: "Simulation-based Self-driving Car using Reinforcement Learning", section IV.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

TERMS = ("collision", "proximity", "gate")
"""The order of the terms in every tensor of them."""


@dataclass(frozen=True)
class Reward:
    """What a step earns.

    Attributes:
        collision: for touching a wall.
        proximity: for any sensor reading below `proximity_threshold`; not on top of a collision.
        gate: for each gate passed.
        proximity_threshold: as a share of the sensor's range, 0..1.
    """

    collision: float = -200.0
    proximity: float = -20.0
    gate: float = 50.0
    proximity_threshold: float = 0.1

    def is_near_wall(self, observation: Tensor) -> Tensor:
        """Whether any sensor reads below the threshold: [B, R] in 0..1 to [B] bool."""
        return observation.amin(dim=-1) < self.proximity_threshold

    def terms(self, observation: Tensor, collided: Tensor, gates_passed: Tensor) -> Tensor:
        """The reward of a step, split into `TERMS`; the reward is their sum.

        Args:
            observation: what the sensors read after the step, [B, R], in 0..1.
            collided: [B], bool.
            gates_passed: in this step, [B], int64.

        Returns:
            [B, 3], float32.
        """
        near = self.is_near_wall(observation) & ~collided
        counts = torch.stack([collided, near, gates_passed], dim=-1).to(observation.dtype)
        return counts * counts.new_tensor([self.collision, self.proximity, self.gate])
