"""The training loop: collect, store, learn, record, evaluate.

Shapes: `A` agents, `N` cars of each, `T` steps of each car in a batch, `F` = N * T transitions of each agent in it.
"""

import time
from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase

from carrl.data.replay_buffer import KEYS
from carrl.record.messages import Metrics
from carrl.record.schema import COLUMNS
from carrl.run.build import Pipeline
from carrl.run.episodes import EpisodeTracker
from carrl.run.folder import RunFolder
from carrl.run.metrics import mean_action_value, td_error
from carrl.run.moment import Moment
from carrl.run.training import Training

LOGGED_TOGETHER = 2048
"""Env steps of each agent after which they are logged."""
LOGGED_WITHIN_S = 1.0
"""Wall time after which they are logged, if they are fewer."""
METRICS_INTERVAL_S = 0.5
"""Wall time for each agent after which learning is measured with the next transitions logged; one takes about 2 ms."""
LOGGED_KEYS = list(dict.fromkeys([column.key for column in COLUMNS] + list(KEYS)))
"""The log's columns, and what the loss reads besides."""


class Trainer(Training):
    """Trains agents side by side, each until it reaches a limit or `stop` is called.

    The order of a round: every car takes its steps; the transitions are stored and logged; then there is one update
    of each agent for each of its env steps, once the buffer holds a batch, and the target networks follow at env steps
    C, 2C, 3C. An agent whose run is over drives on unrecorded until the last one's is.

    Args:
        pipeline: of a run that starts at frame 0.
        folders: one for each agent.
    """

    def __init__(self, pipeline: Pipeline, folders: Sequence[RunFolder]) -> None:
        super().__init__(pipeline, folders)
        self._pipeline = pipeline
        agents = pipeline.agents
        cars = pipeline.env.batch_size[0] // len(agents)
        time_step = pipeline.env.simulator.vehicle.time_step
        gates = [track.gate_count for track in pipeline.env.tracks]
        self._tracker = EpisodeTracker(len(agents), cars, gates, time_step)
        self._validation = pipeline.world.validation_simulator(pipeline.env.device)
        self._evaluated_at = 0
        self._unlogged: list[TensorDictBase] = []
        self._logged, self._logged_at = 0, self._began
        self._measured, self._measured_at = 0, self._began
        self._active = dict(enumerate(self.runs))

    @property
    def frames(self) -> int:
        """Env steps done by each agent that is not over yet."""
        return self._tracker.frames

    def run(self, on_round: Callable[["Trainer"], None]) -> None:
        """Trains; `on_round` is called after every round of collecting and learning.

        Raises:
            CarrlError: a log or a checkpoint cannot be written, or a loss is not a number.
        """
        try:
            for batch in self._pipeline.collector:
                self._learn_from(batch)
                on_round(self)
                self._end_runs()
                if not self._active:
                    break
        finally:
            self._log()
            self._pipeline.collector.shutdown()

    def _learn_from(self, batch: TensorDictBase) -> None:
        frames_before = self.frames
        ended = self._tracker.follow(batch)
        # [A * N, T] to [F, A], in the order of time: an item of the buffer is one transition of each agent.
        by_agent = batch.view(len(self.runs), -1, batch.shape[1]).permute(2, 1, 0).flatten(0, 1)
        self._pipeline.replay_buffer.extend(by_agent.select(*KEYS))
        self._record(by_agent)
        self._pipeline.learner.learn(len(by_agent))
        self._pipeline.exploration.step(len(by_agent))
        losses = self._pipeline.learner.losses.tolist()
        for index, run in self._active.items():
            run.add_episodes(ended[index], self._moment(losses[index]))
        interval = self._pipeline.evaluation.interval
        if self.frames // interval > frames_before // interval:
            self._evaluate()

    def _record(self, by_agent: TensorDictBase) -> None:
        """Keeps transitions [F, A] to be logged together, and logs them when that is due."""
        self._unlogged.append(by_agent.select(*LOGGED_KEYS).clone())
        if self.frames - self._logged >= LOGGED_TOGETHER or time.monotonic() >= self._logged_at + LOGGED_WITHIN_S:
            self._log()
        if self._learns_for_the_first_time():
            self._log()
            for run in self._active.values():
                run.folder.flush()

    def _learns_for_the_first_time(self) -> bool:
        """Whether the next call of `learn` makes the first update, and compiles it, which can take half a minute."""
        buffer = self._pipeline.replay_buffer
        return self._pipeline.learner.updates == 0 and len(buffer) >= buffer.batch_size

    def _log(self) -> None:
        """Logs the transitions since the last call, many at once, which costs little more than a few."""
        if not self._unlogged:
            return
        transitions, now = torch.cat(self._unlogged), time.monotonic()
        self._unlogged, self._logged, self._logged_at = [], self.frames, now  # nothing is logged again after a failure
        for index, run in self._active.items():
            run.folder.record(transitions[:, index])
        if now >= self._measured_at + METRICS_INTERVAL_S * len(self.runs):
            self._measure(transitions, now)

    def _measure(self, transitions: TensorDictBase, now: float) -> None:
        """Logs how every agent's learning goes, measured on these transitions [F, A]."""
        learner = self._pipeline.learner
        rate = (self.frames - self._measured) / (now - self._measured_at)
        self._measured, self._measured_at = self.frames, now
        losses = learner.losses.tolist()
        for index, run in self._active.items():
            if run.folder.has_log:
                metrics = Metrics(
                    frame=self.frames,
                    updates=learner.updates,
                    loss=losses[index],
                    td_error=td_error(run.agent, transitions[:, index]),
                    action_value=mean_action_value(transitions[:, index]),
                    epsilon=self._pipeline.exploration.epsilon,
                    frames_per_second=rate,
                )
                run.folder.add_metrics(metrics)

    def _moment(self, loss: float) -> Moment:
        pipeline = self._pipeline
        return Moment(self.frames, pipeline.learner.updates, pipeline.exploration.epsilon, loss, self.wall_time_s)

    def _evaluate(self) -> None:
        self._evaluated_at = self.frames
        trials = self._drive(self._validation)
        for index, run in self._active.items():
            run.add_evaluation(trials[index], self._moment(run.moment.loss))

    def _end_runs(self) -> None:
        """Lets go of the agents that have reached a limit, evaluated as they are now."""
        plan = self._pipeline.plan
        over = [
            index
            for index, run in self._active.items()
            if self._stopping or run.episodes >= plan.episodes or self.frames >= plan.frames
        ]
        if over and self._evaluated_at != self.frames:
            self._evaluate()
        if over:
            self._log()
        for index in over:
            del self._active[index]
