"""How well a network drives: a greedy lap of the training track, or of each circuit kept for validation."""

import math
from dataclasses import dataclass
from typing import Any

from carrl.evaluation.rollout import Drive


@dataclass(frozen=True)
class Trial:
    """Drives of one network.

    Attributes:
        drives: one for each circuit, in the order of `Circuits.validation`.
    """

    drives: tuple[Drive, ...]

    @property
    def laps_completed(self) -> int:
        """On how many circuits the lap was completed."""
        return sum(drive.lap_completed for drive in self.drives)

    @property
    def lap_completed(self) -> bool:
        """Whether it was on every one."""
        return self.laps_completed == len(self.drives)

    @property
    def shown(self) -> int:
        """Which drive to look at: the first one of those with the least progress."""
        return min(range(len(self.drives)), key=lambda index: self.drives[index].progress)

    @property
    def quality(self) -> tuple[float, ...]:
        """Orders trials: complete laps first, then by progress, reward and how they steer."""
        others = ("progress", "lap_reward", "steering_reward", "forward_share")
        return (self.laps_completed, *(self._mean(name) for name in others))

    def measures(self) -> dict[str, Any]:
        """The figures, ready for JSON: of several drives the means, of counts rounded, and how many are laps."""
        first, *others = (drive.measures() for drive in self.drives)
        if not others:
            return first
        means = {name: self._mean(name) for name in first}
        return {
            **means,
            **{name: round(means[name]) for name in ("lap_steps", "reversals")},
            "lap_completed": self.lap_completed,
            "collided": any(drive.collided for drive in self.drives),
            "circuits": len(self.drives),
            "laps_completed": self.laps_completed,
        }

    def state_dict(self) -> list[dict[str, Any]]:
        """All of it, arrays as tensors."""
        return [drive.state_dict() for drive in self.drives]

    @classmethod
    def from_state_dict(cls, state: list[dict[str, Any]]) -> "Trial":
        """What `state_dict` told of."""
        return cls(tuple(map(Drive.from_state_dict, state)))

    def _mean(self, name: str) -> float:
        return math.fsum(getattr(drive, name) for drive in self.drives) / len(self.drives)
