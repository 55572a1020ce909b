"""Keeps the account of episodes while transitions stream by.

Shapes: `A` agents, `N` cars of each, `B` = A * N cars in all, agent by agent; `T` steps of each car in a batch.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from carrl.log.messages import Episode

_KEYS = ("reward", "done", "terminated", "gates_passed", "step", "track")


class EpisodeTracker:
    """Numbers the episodes of every agent's cars, driven side by side, and sums up each one as it ends.

    Attributes:
        frames: env steps of each agent.
    """

    def __init__(self, agents: int, num_envs: int, gates_per_lap: int | Sequence[int], time_step: float) -> None:
        """Begins with the first episode of every car.

        Args:
            agents: how many.
            num_envs: cars of each.
            gates_per_lap: of every track; or one number for each track.
            time_step: of the simulation, s.
        """
        self._gates_per_lap = np.atleast_1d(gates_per_lap)
        self._time_step = time_step
        self._cars = num_envs
        self._env = np.tile(np.arange(num_envs), agents)
        self._episode = self._env.copy()
        self._return = np.zeros(agents * num_envs)
        self._begin_ns = np.zeros(agents * num_envs, dtype=np.int64)
        self._begun = [num_envs] * agents
        self.frames = 0

    def state_dict(self) -> dict[str, Any]:
        """Where every car's episode stands."""
        return {
            "frames": self.frames,
            "episode": torch.from_numpy(self._episode),
            "return": torch.from_numpy(self._return),
            "begin_ns": torch.from_numpy(self._begin_ns),
            "begun": list(self._begun),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from there.

        Raises:
            ValueError: these are not so many cars.
        """
        self.frames, self._begun = state["frames"], list(state["begun"])
        for own, name in ((self._episode, "episode"), (self._return, "return"), (self._begin_ns, "begin_ns")):
            own[:] = state[name].numpy()

    @property
    def time_ns(self) -> int:
        """Simulated time since the start of the run, ns."""
        return round(self.frames // self._cars * self._time_step * 1e9)

    def follow(self, batch: TensorDictBase) -> list[list[Episode]]:
        """Adds `episode`, `car` and `time_ns` to a batch [B, T] and returns each agent's episodes that ended in it.

        A car whose first transition is a first step, although its episode had others, has begun a new one.
        """
        cars, steps = batch.batch_size
        numbers = np.empty((cars, steps), dtype=np.int64)
        times = np.empty(steps, dtype=np.int64)
        after = {key: batch["next", key].cpu().numpy().reshape(cars, steps) for key in _KEYS}
        self._begin_anew(after["step"][:, 0] == 1)
        poses = batch["next", "pose"].cpu().numpy()
        ended: list[list[Episode]] = [[] for _ in self._begun]
        for step in range(steps):
            numbers[:, step] = self._episode
            times[step] = self.time_ns
            self.frames += self._cars
            self._return += after["reward"][:, step]
            for car in np.flatnonzero(after["done"][:, step]).tolist():
                last = {key: values[car, step] for key, values in after.items()}
                ended[car // self._cars].append(self._end(car, last, tuple(poses[car, step].tolist())))
        batch["episode"] = torch.from_numpy(numbers)
        batch["car"] = torch.from_numpy(self._env)[:, None].expand(cars, steps)
        batch["time_ns"] = torch.from_numpy(times).expand(cars, steps)
        return ended

    def _begin_anew(self, first: np.ndarray) -> None:
        """Numbers a new episode for each car that takes its first step, [B], although its last episode has not ended.

        That is how the cars of a lost worker go on. Of the episode that was cut short there are transitions alone.
        """
        for car in np.flatnonzero(first & (self._begin_ns < self.time_ns)).tolist():
            self._begin(car)

    def _end(self, car: int, after: dict[str, Any], pose: tuple[float, float, float]) -> Episode:
        """Sums up a car's episode from its last step and begins the next."""
        gates, track = int(after["gates_passed"]), int(after["track"])
        episode = Episode(
            episode=int(self._episode[car]),
            env=int(self._env[car]),
            track=track,
            frame=self.frames,
            begin_ns=int(self._begin_ns[car]),
            end_ns=self.time_ns,
            episode_return=float(self._return[car]),
            length=int(after["step"]),
            gates=gates,
            laps=gates // int(self._gates_per_lap[track]),
            ended="collision" if after["terminated"] else "time limit",
            end_pose=pose,
        )
        self._begin(car)
        return episode

    def _begin(self, car: int) -> None:
        agent = car // self._cars
        self._return[car] = 0
        self._begin_ns[car] = self.time_ns
        self._episode[car] = self._begun[agent]
        self._begun[agent] += 1
