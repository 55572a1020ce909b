"""The training loop: collect, store, learn, record, evaluate.

Shapes: `A` agents, `N` cars of each, `T` steps of each car in a batch, `F` = N * T transitions of each agent in it.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase

from carrl.data.collector import cars_of, put_cars_back
from carrl.data.replay_buffer import KEYS, contents_of, put_back
from carrl.errors import ConfigError
from carrl.log.messages import Metrics
from carrl.train.agent_run import AgentRun
from carrl.train.build import Pipeline
from carrl.train.episodes import EpisodeTracker
from carrl.train.folder import RunFolder
from carrl.train.metrics import mean_action_value, td_error
from carrl.train.moment import Moment
from carrl.train.provenance import dqn_columns, log_schema
from carrl.train.state_file import StateFile
from carrl.train.training import Training

LOGGED_TOGETHER = 2048
"""Env steps of each agent after which they are logged."""
LOGGED_WITHIN_S = 1.0
"""Wall time after which they are logged, if they are fewer."""
METRICS_INTERVAL_S = 0.5
"""Wall time for each agent after which learning is measured with the next transitions logged; one takes about 2 ms."""


class Trainer(Training):
    """Trains agents side by side, each until it reaches a limit or `stop` is called.

    The order of a round: every car takes its steps; the transitions are stored and logged; then there is one update
    of each agent for each of its env steps, once the buffer holds a batch, and the target networks follow at env steps
    C, 2C, 3C. An agent whose run is over drives on unrecorded until the last one's is.

    Args:
        pipeline: of a run that starts at frame 0.
        folders: one for each agent.
        state_file: where the state is kept between rounds; None to keep none.
    """

    def __init__(self, pipeline: Pipeline, folders: Sequence[RunFolder], state_file: StateFile | None = None) -> None:
        super().__init__(pipeline, folders, state_file)
        self._pipeline = pipeline
        agents = pipeline.agents
        cars = pipeline.env.batch_size[0] // len(agents)
        time_step = pipeline.env.simulator.vehicle.time_step
        gates = [track.gate_count for track in pipeline.env.tracks]
        self._tracker = EpisodeTracker(len(agents), cars, gates, time_step)
        self._validation = pipeline.world.simulator(pipeline.world.circuits.validation, pipeline.env.device)
        self._evaluated_at = -1
        schema = log_schema(pipeline.env, dqn_columns(pipeline.world.action.names))
        self._logged_keys = list(dict.fromkeys([*schema.keys, *KEYS]))  # the columns, and what the loss reads besides
        self._unlogged: list[TensorDictBase] = []
        self._logged, self._logged_at = 0, self._began
        self._measured, self._measured_at = 0, self._began
        self._active = dict(enumerate(self.runs))

    @property
    def frames(self) -> int:
        """Env steps done by each agent that is not over yet."""
        return self._tracker.frames

    def state_dict(self) -> dict[str, Any]:
        """All that moves; transitions not yet logged are logged first."""
        self._log()
        pipeline = self._pipeline
        return super().state_dict() | {
            "tracker": self._tracker.state_dict(),
            "cars": cars_of(pipeline.collector),
            "streams": pipeline.env.task.streams.state_dict(),
            "exploration": pipeline.exploration.state_dict(),
            "replay_buffer": contents_of(pipeline.replay_buffer),
            **({"returns": pipeline.returns.state_dict()} if pipeline.returns else {}),
            "evaluated_at": self._evaluated_at,
            "active": list(self._active),
        }

    def _load(self, state: dict[str, Any]) -> None:
        pipeline = self._pipeline
        put_back(
            pipeline.replay_buffer, state["replay_buffer"], pipeline.world.action.spec
        )  # before the sampler, which has priorities of its own
        super()._load(state)
        if pipeline.returns:
            pipeline.returns.load_state_dict(state["returns"])
        self._tracker.load_state_dict(state["tracker"])
        put_cars_back(pipeline.collector, state["cars"])
        pipeline.env.task.streams.load_state_dict(state["streams"])
        pipeline.exploration.load_state_dict(state["exploration"])
        self._evaluated_at = state["evaluated_at"]
        self._logged = self._measured = self.frames
        self._active = {index: self.runs[index] for index in state["active"]}
        for run in self.runs:
            if run not in self._active.values() and not self._has_reached_a_limit(run):
                raise ConfigError(
                    f"seed {run.agent.seed} ended at frame {run.moment.frames}, before the others, and what it did "
                    "since is not recorded, so it cannot go on; leave trainer.episodes as it was"
                )

    def run(self, on_round: Callable[["Trainer"], None]) -> None:
        """Trains; `on_round` is called after every round of collecting and learning.

        Raises:
            CarrlError: a log or a checkpoint cannot be written, or a loss is not a number.
        """
        batches = iter(self._pipeline.collector)
        try:
            if self.frames == 0:
                self.save()
            self._end_runs()
            while self._active:
                self._learn_from(next(batches))
                on_round(self)
                self._end_round()
                self._end_runs()
        finally:
            self._log()
            self._pipeline.collector.shutdown()

    def _learn_from(self, batch: TensorDictBase) -> None:
        frames_before = self.frames
        ended = self._tracker.follow(batch)
        # [A * N, T] to [F, A], in the order of time: an item of the buffer is one transition of each agent.
        by_time = batch.view(len(self.runs), -1, batch.shape[1]).permute(2, 1, 0)
        by_agent = by_time.flatten(0, 1)
        self._keep(by_time.select(*KEYS))
        self._record(by_agent)
        self._pipeline.learner.learn(len(by_agent))
        self._pipeline.exploration.step(len(by_agent))
        self._check_losses(self._active, frame=self.frames)
        losses = self._pipeline.learner.losses.tolist()
        for index, run in self._active.items():
            run.add_episodes(ended[index], self._moment(losses[index]))
        interval = self._pipeline.evaluation.interval
        if self.frames // interval > frames_before // interval:
            self._evaluate()

    def _keep(self, transitions: TensorDictBase) -> None:
        """Puts transitions [T, N, A], or what returns over several steps make of them, into the replay buffer."""
        returns = self._pipeline.returns
        kept = transitions if returns is None else returns(transitions)
        if len(kept):
            self._pipeline.replay_buffer.extend(kept.flatten(0, 1))

    def _record(self, by_agent: TensorDictBase) -> None:
        """Keeps transitions [F, A] to be logged together, and logs them when that is due."""
        self._unlogged.append(by_agent.select(*self._logged_keys).clone())
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
            if run.folder.takes_metrics:
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

    def _has_reached_a_limit(self, run: AgentRun) -> bool:
        plan = self._pipeline.plan
        return run.episodes >= plan.episodes or run.moment.frames >= plan.frames

    def _end_runs(self) -> None:
        """Lets go of the agents that have reached a limit, evaluated as they are now, or of all where they are to stop.

        Before the last one goes the state is saved, since a longer run would not be evaluated here. One that is to stop
        is not, as that could take seconds.
        """
        if self._stopping:
            self.save()
            for run in self._active.values():
                run.keep_network("last", run.moment)
            self._let_go(list(self._active))
            return
        over = [index for index, run in self._active.items() if self._has_reached_a_limit(run)]
        if len(over) == len(self._active):
            self.save()
        if over and self._evaluated_at != self.frames:
            self._evaluate()
        self._let_go(over)

    def _let_go(self, over: Sequence[int]) -> None:
        if over:
            self._log()
        for index in over:
            del self._active[index]
