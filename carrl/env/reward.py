"""The paper's reward, term by term, one of our own for smooth driving, and one that leads the way to the next gate.

Shapes: `B` cars, `K` terms.

Source: "Simulation-based Self-driving Car using Reinforcement Learning", section IV.
"""

import sys
from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.env.checks import number
from carrl.errors import ConfigError
from carrl.sim.vehicle import Action

TERMS = ("collision", "proximity", "gate", "steering")
"""The order of the terms in every tensor of them; the paper has all but the last."""
SHAPING = "shaping"
"""One more term, where there is any."""
_MOST = sys.float_info.max


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
        approach: for each metre by which the next gate comes closer, by potential-based shaping; not the paper's.
        discount: of the values that are learnt; the potentials after a step count by it.
    """

    collision: float = -200.0
    proximity: float = -20.0
    gate: float = 50.0
    proximity_threshold: float = 0.1
    turn: float = 0.0
    switch: float = 0.0
    approach: float = 0.0
    discount: float = 1.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a value that is no finite number, and if the shaping's weight or discount is none."""
        for name, value in vars(self).items():
            number(f"reward.{name}", value, -_MOST, _MOST, "a finite number")
        if not self.approach >= 0:
            raise ConfigError(f"reward.approach is {self.approach}; it must be 0 or more per metre")
        if not 0 <= self.discount <= 1:
            raise ConfigError(f"reward.discount is {self.discount}; it must lie in 0..1")

    @property
    def term_names(self) -> tuple[str, ...]:
        """What the terms are called, in their order."""
        return (*TERMS, SHAPING) if self.approach else TERMS

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
            [B, 4], float32: all but the shaping.
        """
        near = self.is_near_wall(readings) & ~collided
        paper = collided * self.collision, near * self.proximity, gates_passed * self.gate
        return torch.stack([*paper, self._steering(action, last_action)], dim=-1).to(readings.dtype)

    def shaping(self, distance_before: Tensor, distance_after: Tensor, terminated: Tensor) -> Tensor:
        """What a step earns by coming closer to the next gate, [B], float32.

        The potential of a situation is -approach * distance, that of the end of an episode 0, and a step earns
        discount * potential after it - potential before it. Whatever the potentials are, the best policy stays the
        best: all that they give is taken back, at the latest when the gate is passed and the next one is far away.

        Source: Ng, Harada and Russell 1999, "Policy Invariance Under Reward Transformations", theorem 1.

        Args:
            distance_before: from the next gate, before the step, [B], m.
            distance_after: from what is the next gate then, after it, [B], m.
            terminated: whether the episode ended there, [B], bool.
        """
        after = torch.where(terminated, 0, distance_after)
        return (self.approach * (distance_before - self.discount * after)).float()

    @staticmethod
    def of_paper(terms: Tensor) -> Tensor:
        """The sum of the paper's terms: [..., K] to [...]."""
        return terms[..., :3].sum(dim=-1)

    @staticmethod
    def of_steering(terms: Tensor) -> Tensor:
        """What turns and switches earn: [..., K] to [...]."""
        return terms[..., 3]

    def _steering(self, action: Tensor, last_action: Tensor) -> Tensor:
        if not self.turn and not self.switch:
            return torch.zeros(action.shape, device=action.device)
        steer, last_steer = _steer(action), _steer(last_action)
        return self.turn * steer.abs() + self.switch * (steer - last_steer).abs()


def _steer(action: Tensor) -> Tensor:
    """1 for left, 0 for forward, -1 for right."""
    return (action == Action.LEFT).int() - (action == Action.RIGHT).int()
