"""Where the transitions that a run learns from come from: the simulator, in one process or many, or logs.

Episodes are accounted for as transitions stream by.

Shapes: `A` replicates, `N` cars of each, `B` = A * N cars in all, `T` steps of each car in a batch,
`F` = N * T transitions of each replicate.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from carrl.data.collector import Collector
from carrl.data.replay_buffer import KEYS, NStepReturns, contents_of, restore_contents
from carrl.env.track_env import TrackEnv
from carrl.log.messages import Episode, how_ended

_KEYS = ("reward", "done", "terminated", "gates_passed", "step", "track")


class EpisodeTracker:
    """Numbers the episodes of every replicate's cars, driven side by side, and sums up each one as it ends.

    Attributes:
        frames: env steps of each replicate.
    """

    def __init__(self, replicates: int, num_envs: int, gates_per_lap: int | Sequence[int], time_step: float) -> None:
        """Begins with the first episode of every car.

        Args:
            replicates: how many.
            num_envs: cars of each.
            gates_per_lap: of every track; or one number for each track.
            time_step: of the simulation, s.
        """
        self._gates_per_lap = np.atleast_1d(gates_per_lap)
        self._time_step = time_step
        self._cars = num_envs
        self._env = np.tile(np.arange(num_envs), replicates)
        self._episode = self._env.copy()
        self._return = np.zeros(replicates * num_envs)
        self._begin_ns = np.zeros(replicates * num_envs, dtype=np.int64)
        self._begun = [num_envs] * replicates
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
        """Adds `episode`, `car` and `time_ns` to a batch [B, T] and returns each replicate's episodes that ended in it.

        A car whose first transition is a first step, although its episode had others, has begun a new one.
        """
        cars, steps = batch.batch_size
        numbers = np.empty((cars, steps), dtype=np.int64)
        times = np.empty(steps, dtype=np.int64)
        after = {key: batch["next", key].cpu().numpy().reshape(cars, steps) for key in _KEYS}
        collided = batch.get(("next", "collided"), batch["next", "terminated"])
        after["collided"] = collided.cpu().numpy().reshape(cars, steps)
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
            ended=how_ended(after["terminated"], after["collided"]),
            end_pose=pose,
        )
        self._begin(car)
        return episode

    def _begin(self, car: int) -> None:
        replicate = car // self._cars
        self._return[car] = 0
        self._begin_ns[car] = self.time_ns
        self._episode[car] = self._begun[replicate]
        self._begun[replicate] += 1


UPDATES_PER_ROUND = 250
"""Of a run that learns from logs: after so many, progress is noted, and it may be stopped."""
SAMPLE_SIZE = 256
"""Logged transitions on which progress is measured, spread evenly over the logs."""


class Round(NamedTuple):
    """What a source brings to be learnt from at once.

    Attributes:
        steps: of each replicate; as many updates are due, unless several steps share one.
        transitions: gives those that were collected, with some of their keys, in the order of time, [F, A]; None where
            all are in the memory already.
        episodes: of each replicate that ended.
    """

    steps: int
    transitions: Callable[[Sequence[Any]], TensorDictBase] | None
    episodes: list[list[Episode]]


class Source(ABC):
    """Puts transitions into the replay memory, a round at a time.

    Attributes:
        sample: logged transitions [P] to measure progress on, the same for all replicates; None in the simulator.
        transitions: from logs, in all; None in the simulator.
        env: in which cars are driven; None where there is no simulator.
        cars: of each replicate.
    """

    env: TrackEnv | None = None
    cars = 0
    sample: TensorDictBase | None = None
    transitions: int | None = None

    @property
    def frames(self) -> int:
        """Env steps of each replicate so far; none without a simulator."""
        return 0

    @abstractmethod
    def collect(self, updates: int) -> Round:
        """The next round of a run that has made so many updates."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """All that moves, the memory included."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there.

        Raises:
            ValueError, RuntimeError: it is the state of something else.
        """

    def close(self) -> None:  # noqa: B027 (most have nothing to let go of)
        """Lets go of what drives the cars."""


class Simulated(Source):
    """Cars that are driven in the simulator.

    Args:
        env: with the cars of all replicates.
        collector: that drives them.
        buffer: to be filled.
        returns: what makes transitions over several steps of them, if anything does.
    """

    def __init__(
        self,
        env: TrackEnv,
        collector: Collector,
        buffer: TensorDictReplayBuffer,
        returns: NStepReturns | None,
    ) -> None:
        self.env: TrackEnv = env
        self.collector, self.returns = collector, returns
        self._buffer = buffer
        self._replicates = buffer.sampler.replicates
        self.cars = int(env.batch_size[0]) // self._replicates
        gates = [track.gate_count for track in env.tracks]
        self._tracker = EpisodeTracker(self._replicates, self.cars, gates, env.simulator.vehicle.time_step)
        self._batches: Iterator[TensorDictBase] | None = None

    @property
    def frames(self) -> int:
        """Env steps of each replicate so far."""
        return self._tracker.frames

    def collect(self, updates: int) -> Round:
        """Lets every car take its steps, and stores their transitions."""
        if self._batches is None:
            self._batches = iter(self.collector)
        batch = next(self._batches)
        ended = self._tracker.follow(batch)
        transitions = self._by_time(batch.select(*KEYS))
        kept = transitions if self.returns is None else self.returns(transitions)
        if len(kept):
            self._buffer.extend(kept.flatten(0, 1))
        return Round(
            steps=len(transitions) * self.cars,
            transitions=lambda keys: self._by_time(batch.select(*keys)).flatten(0, 1),
            episodes=ended,
        )

    def _by_time(self, batch: TensorDictBase) -> TensorDictBase:
        """[A * N, T] to [T, N, A]: an item of the buffer is one transition of each replicate."""
        return batch.view(self._replicates, -1, batch.shape[1]).permute(2, 1, 0)

    def state_dict(self) -> dict[str, Any]:
        """Where cars, episodes and random numbers stand, and what is in the memory."""
        return {
            "tracker": self._tracker.state_dict(),
            "cars": self.collector.cars(),
            "streams": self.env.task.streams.state_dict(),
            "replay_buffer": contents_of(self._buffer),
            **({"returns": self.returns.state_dict()} if self.returns else {}),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there.

        Raises:
            ValueError, RuntimeError: it is the state of other cars.
        """
        restore_contents(self._buffer, state["replay_buffer"], self.env.task.action.spec)
        if self.returns:
            self.returns.load_state_dict(state["returns"])
        self._tracker.load_state_dict(state["tracker"])
        self.collector.load_cars(state["cars"])
        self.env.task.streams.load_state_dict(state["streams"])

    def close(self) -> None:
        """Ends the collector."""
        self.collector.shutdown()


class Logged(Source):
    """Logs, all of whose transitions are in the memory already: there is no simulator.

    Args:
        buffer: with the transitions.
        updates: to be made in all.
    """

    def __init__(self, buffer: TensorDictReplayBuffer, updates: int) -> None:
        self.transitions = len(buffer)
        self._updates, self._replicates = updates, buffer.sampler.replicates
        items = torch.linspace(0, self.transitions - 1, min(SAMPLE_SIZE, self.transitions)).long()
        self.sample = buffer.storage.get(items)[:, 0].clone()

    def collect(self, updates: int) -> Round:
        """Nothing new; the next updates are due."""
        return Round(min(UPDATES_PER_ROUND, self._updates - updates), None, [[] for _ in range(self._replicates)])

    def state_dict(self) -> dict[str, Any]:
        """Nothing moves; the transitions are none of it."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on."""
