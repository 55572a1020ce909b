"""What a trainer does beside training: record, measure, evaluate.

Shapes: `A` replicates, `F` transitions of each.
"""

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase

from carrl.data.description import log_schema
from carrl.data.replay_buffer import KEYS
from carrl.data.source import Round
from carrl.evaluation.results import EvaluationResult, Rollout
from carrl.evaluation.rollout import rollout
from carrl.log.messages import Metrics
from carrl.sim.simulator import Simulator
from carrl.train.plan import EvaluationPlan

if TYPE_CHECKING:
    from carrl.train.trainer import Trainer

LOGGED_TOGETHER = 2048
"""Env steps of each replicate after which they are logged."""
LOGGED_WITHIN_S = 1.0
"""Wall time after which they are logged, if they are fewer."""
METRICS_INTERVAL_S = 0.5
"""Wall time for each replicate after which learning is measured with the next transitions logged; it takes 2 ms."""


class Callback:
    """Follows a training run; override what is of use."""

    def on_start(self, trainer: "Trainer") -> None:
        """Called once, before the first round."""

    def on_round(self, trainer: "Trainer") -> None:
        """Called after every round of collecting and learning; `trainer.stop()` ends the run, all of it saved."""

    def on_end(self) -> None:
        """Called once after the last round, also where an error ended the run."""

    def on_collected(self, trainer: "Trainer", batch: Round) -> None:
        """A round's transitions are in the memory, and nothing was learnt from them yet."""

    def on_learnt(self, trainer: "Trainer", batch: Round) -> None:
        """All updates of a round are made."""

    def on_flush(self, trainer: "Trainer") -> None:
        """Nothing may be held back: the state is to be saved, or replicates' runs end."""

    def on_limit(self, trainer: "Trainer", replicates: Sequence[int]) -> None:
        """These replicates have reached a limit; their runs end after this."""

    def state_dict(self) -> dict[str, Any]:
        """What is to be remembered."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any], trainer: "Trainer") -> None:
        """Goes on from there, as the trainer does."""


class Recorder(Callback):
    """Writes transitions to the logs, many at once, which costs little more than a few."""

    def __init__(self) -> None:
        self._keys: list[Any] = []
        self._waiting: list[TensorDictBase] = []
        self._logged, self._logged_at = 0, time.monotonic()
        self._measured, self._measured_at = 0, self._logged_at

    def load_state_dict(self, state: Mapping[str, Any], trainer: "Trainer") -> None:
        """Goes on from there; the logs are written up to there."""
        self._logged = self._measured = trainer.frames

    def on_collected(self, trainer: "Trainer", batch: Round) -> None:
        """Keeps the transitions to be logged together, and logs them when that is due."""
        if batch.transitions is None or trainer.source.env is None:
            return
        if not self._keys:
            schema = log_schema(trainer.source.env.task, trainer.algorithm.log_columns)
            self._keys = list(dict.fromkeys([*schema.keys, *KEYS]))  # the columns, and what the loss reads besides
        self._waiting.append(batch.transitions(self._keys).clone())
        if trainer.frames - self._logged >= LOGGED_TOGETHER or time.monotonic() >= self._logged_at + LOGGED_WITHIN_S:
            self.on_flush(trainer)
        if trainer.learner.learns_for_the_first_time:  # half a minute, in which a kill would lose them
            self.on_flush(trainer)
            for run in trainer.active.values():
                run.folder.flush()

    def on_flush(self, trainer: "Trainer") -> None:
        """Logs the transitions since the last call."""
        if not self._waiting:
            return
        transitions, now = torch.cat(self._waiting), time.monotonic()
        self._waiting, self._logged, self._logged_at = [], trainer.frames, now  # none again after a failure
        for index, run in trainer.active.items():
            run.folder.record(transitions[:, index])
        if now >= self._measured_at + METRICS_INTERVAL_S * len(trainer.runs):
            self._measure(trainer, transitions, now)

    def _measure(self, trainer: "Trainer", transitions: TensorDictBase, now: float) -> None:
        """Logs how every replicate's learning goes, measured on these transitions [F, A]."""
        rate = (trainer.frames - self._measured) / (now - self._measured_at)
        self._measured, self._measured_at = trainer.frames, now
        if not any(run.folder.takes_metrics for run in trainer.active.values()):
            return
        losses, figures = trainer.learner.losses.tolist(), trainer.algorithm.measure(transitions)
        for index, run in trainer.active.items():
            metrics = Metrics(
                frame=trainer.frames,
                updates=trainer.updates,
                loss=losses[index],
                frames_per_second=rate,
                figures=figures[index],
            )
            run.folder.add_metrics(metrics)


class LoggedProgress(Callback):
    """Where transitions come from logs, adds a row for each round to the tables, as there are no episodes."""

    def on_learnt(self, trainer: "Trainer", batch: Round) -> None:
        """Measures every replicate on a fixed sample of the logged transitions."""
        sample = trainer.source.sample
        if sample is None:
            return
        for run, figures in zip(trainer.runs, trainer.algorithm.measure_logged(sample), strict=True):
            status = run.status
            row = {"updates": status.updates, "loss": status.loss, **figures, "wall_time_s": status.wall_time_s}
            run.folder.add_learnt(row)


class Evaluator(Callback):
    """Greedy laps of every validation circuit, every so many env steps and at the end.

    Args:
        plan: how often, from how many places, and how many laps; None for one from the start line, at the end alone.
    """

    def __init__(self, plan: EvaluationPlan | None) -> None:
        self._interval = plan.interval if plan else None
        self._starts, self._laps = (plan.starts, plan.laps) if plan else (1, 1)
        self._evaluated_at, self._round_began_at = -1, 0
        self._simulator: Simulator | None = None  # where transitions come from logs, there is none before the end

    def state_dict(self) -> dict[str, Any]:
        """When the latest evaluation was."""
        return {"evaluated_at": self._evaluated_at}

    def load_state_dict(self, state: Mapping[str, Any], trainer: "Trainer") -> None:
        """Goes on from there."""
        self._evaluated_at, self._round_began_at = state["evaluated_at"], trainer.frames

    def on_learnt(self, trainer: "Trainer", batch: Round) -> None:
        """Evaluates if the round has passed a multiple of the interval."""
        before, self._round_began_at = self._round_began_at, trainer.frames
        if self._interval is not None and trainer.frames // self._interval > before // self._interval:
            self._evaluate(trainer)

    def on_limit(self, trainer: "Trainer", replicates: Sequence[int]) -> None:
        """Evaluates the networks as they are, unless that was done."""
        if self._evaluated_at != trainer.frames:
            self._evaluate(trainer)

    def _evaluate(self, trainer: "Trainer") -> None:
        self._evaluated_at = trainer.frames
        with trainer.evaluated_weights():
            evaluations = self.drive(trainer)
            for index, run in trainer.active.items():
                run.add_evaluation(evaluations[index], trainer.status(run.status.loss))

    def drive(self, trainer: "Trainer") -> list[EvaluationResult]:
        """The evaluation of every replicate's network, all driven side by side."""
        world, replicates = trainer.pipeline.world, len(trainer.runs)
        circuits, starts = len(world.circuits.validation), self._starts
        if self._simulator is None:
            self._simulator = world.simulator(world.circuits.validation, trainer.algorithm.collect_policy.device)
        track = torch.arange(circuits).repeat_interleave(starts).repeat(replicates)
        stations = self._simulator.routes.lengths[track] * torch.arange(starts).repeat(circuits * replicates) / starts
        drives_each = circuits * starts

        def of_replicates(drives: Sequence[Rollout]) -> list[EvaluationResult]:
            begins = range(0, len(drives), drives_each)
            return [EvaluationResult(tuple(drives[begin : begin + drives_each])) for begin in begins]

        def shown(drives: Sequence[Rollout]) -> list[int]:
            return [number * drives_each + result.shown for number, result in enumerate(of_replicates(drives))]

        policy = trainer.algorithm.greedy_policy
        return of_replicates(rollout(world, self._simulator, policy, stations, track, kept=shown, laps=self._laps))
