"""Keeps the account of episodes while transitions stream by.

Shapes: `A` agents, `N` cars of each, `B` = A * N cars in all, agent by agent; `T` steps of each car in a batch.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase

_KEYS = ("reward", "done", "terminated", "gates_passed", "step")


@dataclass(frozen=True)
class Episode:
    """One episode that has ended.

    Attributes:
        episode: its number in the run, from 0, in the order in which episodes began.
        frame: env steps of the whole run when it ended.
        env: which car of the run drove it.
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
    """Numbers the episodes of every agent's cars, driven side by side, and sums up each one as it ends.

    Attributes:
        frames: env steps of each agent.
    """

    def __init__(self, agents: int, num_envs: int, gates_per_lap: int) -> None:
        """Begins with the first episode of every car."""
        self._gates_per_lap = gates_per_lap
        self._cars = num_envs
        self._env = np.tile(np.arange(num_envs), agents)
        self._episode = self._env.copy()
        self._return = np.zeros(agents * num_envs)
        self._begun = [num_envs] * agents
        self.frames = 0

    def follow(self, batch: TensorDictBase) -> list[list[Episode]]:
        """Adds the keys `episode` and `env` to a batch [B, T] and returns each agent's episodes that ended in it."""
        cars, steps = batch.batch_size
        numbers = np.empty((cars, steps), dtype=np.int64)
        after = {key: batch["next", key].cpu().numpy().reshape(cars, steps) for key in _KEYS}
        ended: list[list[Episode]] = [[] for _ in self._begun]
        for step in range(steps):
            numbers[:, step] = self._episode
            self.frames += self._cars
            self._return += after["reward"][:, step]
            for car in np.flatnonzero(after["done"][:, step]).tolist():
                last = {key: values[car, step] for key, values in after.items()}
                ended[car // self._cars].append(self._end(car, last))
        batch["episode"] = torch.from_numpy(numbers)
        batch["env"] = torch.from_numpy(self._env)[:, None].expand(cars, steps)
        return ended

    def _end(self, car: int, after: dict[str, Any]) -> Episode:
        """Sums up a car's episode from its last step and begins the next."""
        gates = int(after["gates_passed"])
        episode = Episode(
            episode=int(self._episode[car]),
            frame=self.frames,
            env=int(self._env[car]),
            episode_return=float(self._return[car]),
            length=int(after["step"]),
            gates=gates,
            laps=gates // self._gates_per_lap,
            ended="collision" if after["terminated"] else "time limit",
        )
        agent = car // self._cars
        self._return[car] = 0
        self._episode[car] = self._begun[agent]
        self._begun[agent] += 1
        return episode
