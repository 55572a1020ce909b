"""Keeps the account of episodes while transitions stream by.

Shapes: `N` cars, `T` steps of each in a batch.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import TensorDictBase

_KEYS = ("reward", "done", "terminated", "gates_passed", "step")


@dataclass(frozen=True)
class Episode:
    """One episode that has ended.

    Attributes:
        episode: its number in the run, from 0, in the order in which episodes began.
        frame: env steps of the whole run when it ended.
        env: which car drove it.
        episode_return: undiscounted sum of its rewards.
        length: its steps.
        gates: gates passed.
        laps: complete laps, each of all gates.
        ended: why.
    """

    episode: int
    frame: int
    env: int
    episode_return: float
    length: int
    gates: int
    laps: int
    ended: Literal["collision", "time limit"]


class EpisodeTracker:
    """Numbers the episodes of N cars driven side by side and sums up each one as it ends."""

    def __init__(self, num_envs: int, gates_per_lap: int) -> None:
        """Begins with the first episode of every car."""
        self._gates_per_lap = gates_per_lap
        self._episode = torch.arange(num_envs)
        self._return = torch.zeros(num_envs, dtype=torch.float64)
        self._begun = num_envs
        self.frames = 0

    def follow(self, batch: TensorDictBase) -> list[Episode]:
        """Adds the keys `episode` and `env` to a batch [N, T] and returns the episodes ended in it."""
        cars, steps = batch.batch_size
        numbers = torch.empty(cars, steps, dtype=torch.int64)
        after = batch["next"].select(*_KEYS).cpu()
        ended: list[Episode] = []
        for step in range(steps):
            numbers[:, step] = self._episode
            ended += self._follow_step(after[:, step])
        batch["episode"] = numbers
        batch["env"] = torch.arange(cars)[:, None].expand(cars, steps)
        return ended

    def _follow_step(self, after: TensorDictBase) -> list[Episode]:
        self.frames += len(self._episode)
        self._return += after["reward"].view(-1)
        ended = [self._sum_up(after, car) for car in after["done"].view(-1).nonzero().view(-1).tolist()]
        for episode in ended:
            self._return[episode.env] = 0
            self._episode[episode.env] = self._begun
            self._begun += 1
        return ended

    def _sum_up(self, after: TensorDictBase, car: int) -> Episode:
        gates = int(after["gates_passed"][car])
        return Episode(
            episode=int(self._episode[car]),
            frame=self.frames,
            env=car,
            episode_return=float(self._return[car]),
            length=int(after["step"][car]),
            gates=gates,
            laps=gates // self._gates_per_lap,
            ended="collision" if after["terminated"][car].item() else "time limit",
        )
