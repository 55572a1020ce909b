"""The training loop: collect, store, learn, record, evaluate.

Shapes: `N` cars, `T` steps of each in a batch, `F` = N * T transitions in a batch.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase

from carrl.data.replay_buffer import KEYS
from carrl.errors import CarrlError
from carrl.run.build import Pipeline
from carrl.run.episodes import Episode, EpisodeTracker
from carrl.run.evaluation import Drive, drive, greedy_policy
from carrl.run.folder import RunFolder

RECENT_EPISODES = 20
"""The paper averages returns over this many episodes (figure 3)."""


@dataclass(frozen=True)
class FirstLap:
    """The first complete lap of the greedy policy: after how many ended episodes, env steps and seconds."""

    episode: int
    frame: int
    wall_time_s: float


class Trainer:
    """Trains until a limit is reached or `stop` is called.

    The order of a round: every car takes its steps; the transitions are stored and logged; then there is one update
    for each env step, once the buffer holds a batch, and the target network follows at env steps C, 2C, 3C.
    """

    def __init__(self, pipeline: Pipeline, folder: RunFolder) -> None:
        """Prepares a run that starts at frame 0."""
        self._pipeline, self._folder = pipeline, folder
        self._tracker = EpisodeTracker(pipeline.env.batch_size[0], pipeline.env.track.gate_count)
        self._recent_returns: deque[float] = deque(maxlen=RECENT_EPISODES)
        self._began = time.monotonic()
        self._stopping = False
        self._evaluated_at = 0
        self._loss = torch.tensor(math.nan)
        self.episode_returns: list[float] = []
        self.updates = 0
        self.laps = 0
        self.first_lap: FirstLap | None = None
        self.best: Drive | None = None
        self.last: Drive | None = None

    @property
    def frames(self) -> int:
        """Env steps done, of all cars together."""
        return self._tracker.frames

    @property
    def episodes(self) -> int:
        """Episodes ended."""
        return len(self.episode_returns)

    @property
    def recent_return(self) -> float:
        """Mean return of the last 20 episodes; nan before the first has ended."""
        return sum(self._recent_returns) / len(self._recent_returns) if self._recent_returns else math.nan

    @property
    def wall_time_s(self) -> float:
        """Seconds since the trainer was made."""
        return time.monotonic() - self._began

    @property
    def epsilon(self) -> float:
        """Probability of a random action in the next step."""
        return self._pipeline.exploration.epsilon

    def stop(self) -> None:
        """Ends the run after the present round, with everything saved."""
        self._stopping = True

    def run(self, on_round: Callable[["Trainer"], None]) -> None:
        """Trains; `on_round` is called after every round of collecting and learning.

        Raises:
            CarrlError: the log or a checkpoint cannot be written, or the loss is not a number.
        """
        limits = self._pipeline.limits
        try:
            for batch in self._pipeline.collector:
                self._learn_from(batch)
                on_round(self)
                if self._stopping or self.episodes >= limits.episodes or self.frames >= limits.frames:
                    break
            if self._evaluated_at != self.frames:
                self._evaluate()
        finally:
            self._pipeline.collector.shutdown()

    def _learn_from(self, batch: TensorDictBase) -> None:
        frames_before = self.frames
        ended = self._tracker.follow(batch)
        transitions = batch.transpose(0, 1).reshape(-1)
        self._pipeline.replay_buffer.extend(transitions.select(*KEYS))
        self._folder.record(transitions, self._simulated_time(frames_before))
        for _ in range(len(transitions)):
            self._update()
            self._pipeline.target_updater.step()
        self._pipeline.exploration.step(len(transitions))
        self._account(ended)
        interval = self._pipeline.evaluation.interval
        if self.frames // interval > frames_before // interval:
            self._evaluate()

    def _update(self) -> None:
        """One gradient step on one sampled batch, once there are enough transitions for it."""
        buffer = self._pipeline.replay_buffer
        if len(buffer) >= buffer.batch_size:
            self._loss = self._pipeline.learner.update()
            self.updates += 1

    def _account(self, ended: list[Episode]) -> None:
        if not ended:
            return
        loss = self._loss.item()
        if self.updates and not math.isfinite(loss):
            raise CarrlError(f"the loss is {loss} at frame {self.frames}; try a smaller optimizer.lr")
        for episode in ended:
            self.episode_returns.append(episode.episode_return)
            self._recent_returns.append(episode.episode_return)
            self.laps += episode.laps
            self._folder.add_episode(episode, self.recent_return, self.epsilon, loss, self.updates, self.wall_time_s)

    def _evaluate(self) -> None:
        """Drives a greedy lap, notes the first and keeps the best policy."""
        pipeline = self._pipeline
        self._evaluated_at = self.frames
        (self.last,) = drive(pipeline.env.simulator, pipeline.world.reward, greedy_policy(pipeline.network))
        if self.last.lap_completed and self.first_lap is None:
            self.first_lap = FirstLap(self.episodes, self.frames, self.wall_time_s)
        self._folder.add_evaluation(self.last, self.frames, self.episodes)
        state = {"network": pipeline.network.state_dict(), "frames": self.frames, "episodes": self.episodes}
        self._folder.save_checkpoint("last", state)
        if self.best is None or _quality(self.last) > _quality(self.best):
            self.best = self.last
            self._folder.save_checkpoint("best", state)

    def _simulated_time(self, frames: int) -> float:
        """Simulated seconds since the start of the run, during which N cars did this many env steps."""
        env = self._pipeline.env
        return frames / env.batch_size[0] * env.simulator.vehicle.time_step


def _quality(attempt: Drive) -> tuple[float, ...]:
    """Orders drives: complete laps first, then by progress, reward and the share of driving straight."""
    return (attempt.lap_completed, attempt.progress, attempt.lap_reward, attempt.forward_share)
