"""The training loop: collect, learn, record, evaluate.

Shapes: `A` replicates.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import Any

import carrl
from carrl.algorithms.algorithm import Algorithm
from carrl.data.source import Source
from carrl.errors import CarrlError, CheckpointError, ConfigError
from carrl.train.averaging import WeightAverages
from carrl.train.build import Pipeline
from carrl.train.callbacks import Callback, Evaluator, LoggedProgress, Recorder
from carrl.train.checkpoint import StateFile, check_fits
from carrl.train.folder import RunFolder
from carrl.train.learner import Learner, divergence_sentence
from carrl.train.replicate_run import ReplicateRun, TrainingStatus


class Trainer:
    """Trains replicates side by side, each until it reaches a limit or `stop` is called.

    The order of a round: the source brings transitions, which are stored and logged; then there is one update of each
    replicate for each of its env steps, once the buffer holds a batch, and target networks follow in their time. Where
    transitions come from logs, a round is so many updates. A replicate whose run is over goes on unrecorded until the
    last one's is.

    Args:
        pipeline: of a run that has done nothing yet.
        folders: one for each replicate.
        state_file: where the state is kept between rounds; None to keep none.

    Attributes:
        runs: of the replicates.
        active: those that are not over, by index.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        folders: Sequence[RunFolder],
        state_file: StateFile | None = None,
    ) -> None:
        self.pipeline = pipeline
        algorithm = pipeline.algorithm
        parts = zip(algorithm.seeds, algorithm.networks, folders, strict=True)
        self.runs = [ReplicateRun(seed, network, folder) for seed, network, folder in parts]
        self.active = dict(enumerate(self.runs))
        self._began = time.monotonic()
        self._start_up_s = self._began - carrl._IMPORTED_AT
        self._stopping = False
        self._state_file = state_file
        horizon = pipeline.evaluation.averaged_updates if pipeline.evaluation else None
        self._averages = WeightAverages(algorithm.networks, horizon) if horizon else None
        self._own_callbacks = [Recorder(), LoggedProgress(), Evaluator(pipeline.evaluation)]
        self._callbacks: Sequence[Callback] = self._own_callbacks

    @property
    def algorithm(self) -> Algorithm:
        """What learns."""
        return self.pipeline.algorithm

    @property
    def source(self) -> Source:
        """Where transitions come from."""
        return self.pipeline.source

    @property
    def learner(self) -> Learner:
        """What makes the updates."""
        return self.pipeline.learner

    @property
    def frames(self) -> int:
        """Env steps done by each replicate that is not over yet; 0 where transitions come from logs."""
        return self.source.frames

    @property
    def updates(self) -> int:
        """Updates of each replicate so far."""
        return self.learner.updates

    @property
    def share_done(self) -> float:
        """How much of the training is done; 1 or more at its end."""
        episodes = min(run.episodes for run in self.runs)  # of the run that ends last
        return self.pipeline.limits.share_done(self.frames, episodes, self.updates)

    @property
    def wall_time_s(self) -> float:
        """Seconds since the training was made, and of the processes that were broken off before, up to their states."""
        return time.monotonic() - self._began

    @property
    def first_update_s(self) -> float | None:
        """Seconds from the training's making to its first update, compilation included; None before that."""
        first = self.learner.first_update_at
        return None if first is None else first - self._began

    @property
    def stopping(self) -> bool:
        """Whether all runs end after the present round."""
        return self._stopping

    def stop(self) -> None:
        """Ends all runs after the present round, with everything saved."""
        self._stopping = True

    def interrupt(self) -> None:
        """The same from a signal's handler, which does not wait for a compilation that is going on.

        Raises:
            KeyboardInterrupt: one is; what is saved is from before it, and nothing was learnt since.
        """
        self.stop()
        self.learner.interrupt()

    def evaluated_weights(self) -> AbstractContextManager[None]:
        """The networks have the weights that are tried out and kept until the end of the `with` statement."""
        return nullcontext() if self._averages is None else self._averages.in_place()

    def status(self, loss: float) -> TrainingStatus:
        """Where the training of a replicate with this loss stands."""
        return TrainingStatus(self.frames, self.updates, loss, self.wall_time_s, self.algorithm.figures())

    def summaries(self) -> list[dict[str, Any]]:
        """The run of each replicate in a few figures, for `summary.json`; all times count from the trainer's making."""
        transitions = self.source.transitions
        return [
            {
                "seed": run.seed,
                "finished": not self.stopping,
                "track": self.pipeline.world.circuits.name,
                **({} if transitions is None else {"transitions": transitions}),
                **run.summary(),
                "start_up_s": round(self._start_up_s, 3),  # of the process, but for its first instant
                "first_update_s": None if self.first_update_s is None else round(self.first_update_s, 3),
            }
            for run in self.runs
        ]

    def run(self, callbacks: Sequence[Callback] = ()) -> None:
        """Trains, followed by the callbacks, besides those that record and evaluate.

        Raises:
            CarrlError: a log, a table or a checkpoint cannot be written, or a loss is not a number.
        """
        self._callbacks = [*self._own_callbacks, *callbacks]
        with ExitStack() as stack:
            for callback in self._callbacks:
                stack.callback(callback.on_end)
                callback.on_start(self)
            try:
                self._make_rounds()
            finally:
                self._flush()
                self.source.close()

    def _make_rounds(self) -> None:
        if self.frames == self.updates == 0:
            self.save()
        self._end_runs()
        while self.active:
            self._make_round()
            for callback in self._callbacks:
                callback.on_round(self)
            self._check_folders()
            if self._state_file is not None and self._state_file.is_due:
                self.save()
            self._end_runs()

    def _make_round(self) -> None:
        batch = self.source.collect(self.updates)
        for callback in self._callbacks:
            callback.on_collected(self, batch)
        self.learner.learn(batch.steps)
        if self._averages is not None:
            self._averages.follow(self.updates)
        self._check_losses()
        losses = self.learner.losses.tolist()
        for index, run in self.active.items():
            run.add_episodes(batch.episodes[index], self.status(losses[index]))
        for callback in self._callbacks:
            callback.on_learnt(self, batch)

    def _check_losses(self) -> None:
        """Ends the training where the loss of a replicate that is not over was not finite."""
        for index, run in self.active.items():
            found = self.learner.divergence_report(index, run.network)
            if found is not None:
                report = {"seed": run.seed, **({"frame": self.frames} if self.frames else {}), **found}
                run.folder.write_divergence(report)
                raise CarrlError(divergence_sentence(report))

    def _has_reached_a_limit(self, run: ReplicateRun) -> bool:
        return self.pipeline.limits.share_done(run.status.frames, run.episodes, run.status.updates) >= 1

    def _end_runs(self) -> None:
        """Lets go of the replicates that have reached a limit, evaluated as they are, or of all if they are to stop.

        Before the last one goes the state is saved, since a longer run would not be evaluated here. One that is to stop
        is not, as that could take seconds.
        """
        if self._stopping:
            self.save()
            with self.evaluated_weights():
                for run in self.active.values():
                    run.keep_network("last")
            self._let_go(list(self.active))
            return
        over = [index for index, run in self.active.items() if self._has_reached_a_limit(run)]
        if len(over) == len(self.active):
            self.save()
        if over:
            for callback in self._callbacks:
                callback.on_limit(self, over)
        self._let_go(over)

    def _let_go(self, over: Sequence[int]) -> None:
        if over:
            self._flush()
        for index in over:
            del self.active[index]

    def _flush(self) -> None:
        for callback in self._callbacks:
            callback.on_flush(self)

    # State

    def state_dict(self) -> dict[str, Any]:
        """All that moves, as tensors and plain values; the logs are on the disk up to here.

        Raises:
            CarrlError: the disk fails.
        """
        self._flush()
        return {"folders": [run.folder.state_dict() for run in self.runs], **self._own_state()}

    def _own_state(self) -> dict[str, Any]:
        return {
            **self.source.state_dict(),
            "algorithm": self.algorithm.state_dict(),
            "learner": self.learner.state_dict(),
            "runs": [run.state_dict() for run in self.runs],
            "callbacks": [callback.state_dict() for callback in self._own_callbacks],
            **({} if self._averages is None else {"averages": self._averages.state_dict()}),
            "active": list(self.active),
            "wall_time_s": self.wall_time_s,
            "first_update_s": self.first_update_s,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there; call it before `run`. The folders must have been opened with their parts of the state.

        Raises:
            CheckpointError: the state is that of another run.
            ConfigError: it cannot go on with its configuration.
        """
        own = self._own_state()
        try:
            check_fits({key: state[key] for key in own if key in state}, own)
            self._load(state)
        except (ValueError, RuntimeError) as error:  # values of the right types that this run cannot have
            raise CheckpointError(f"the state does not fit the run's configuration: {error}") from error

    def _load(self, state: Mapping[str, Any]) -> None:
        self.source.load_state_dict(state)  # before the sampler, which has priorities of its own
        self.algorithm.load_state_dict(state["algorithm"])
        self.learner.load_state_dict(state["learner"])
        if self._averages is not None:
            self._averages.load_state_dict(state["averages"], self.updates)
        for run, own in zip(self.runs, state["runs"], strict=True):
            run.load_state_dict(own)
        for callback, own in zip(self._own_callbacks, state["callbacks"], strict=True):
            callback.load_state_dict(own, self)
        self._began = time.monotonic() - state["wall_time_s"]
        if state["first_update_s"] is not None:
            self.learner.first_update_at = self._began + state["first_update_s"]
        self.active = {index: run for index, run in enumerate(self.runs) if index in state["active"]}
        for run in self.runs:
            if run not in self.active.values() and not self._has_reached_a_limit(run):
                raise ConfigError(
                    f"seed {run.seed} ended at frame {run.status.frames}, before the others, and what it did since is "
                    "not recorded, so it cannot go on; leave trainer.episodes as it was"
                )

    def save(self) -> None:
        """Keeps the state, if it is to be kept at all.

        Raises:
            CarrlError: the disk fails, or a folder was deleted or moved.
        """
        if self._state_file is not None:
            self._check_folders()
            try:
                self._state_file.save(self.state_dict())
            except CheckpointError:
                self._check_folders()  # it may be gone since
                raise

    def _check_folders(self) -> None:
        """Ends the training where a folder was deleted or moved, since what it writes would be lost."""
        if self._state_file is not None and any(run.folder.is_gone for run in self.runs):
            path = self._state_file.run
            raise CarrlError(
                f"the run's folder '{path}' was deleted or moved while it trained; if it was moved, go on with it at "
                "its new place with carrl train resume=, else train anew"
            )
