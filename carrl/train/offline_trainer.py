"""Training on logs: learn, note how far it has come, and drive one lap at the end.

Shapes: `A` agents, `P` transitions of the sample that is measured.
"""

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase

from carrl.train.build import OfflinePipeline
from carrl.train.metrics import td_error
from carrl.train.moment import Moment
from carrl.train.offline_folder import Learnt, OfflineRunFolder
from carrl.train.state_file import StateFile
from carrl.train.training import Training

UPDATES_PER_ROUND = 250
"""After so many, progress is noted, and a run may be stopped."""
SAMPLE_SIZE = 256
"""Transitions on which progress is measured, spread evenly over the logs."""


class OfflineTrainer(Training):
    """Trains agents side by side on the transitions in their buffer, for so many updates or until `stop` is called.

    The target networks follow after C, 2C, 3C updates. Only then, when all is learnt, there is a simulator: it drives
    the networks as they are, and what it finds chooses nothing.

    Args:
        pipeline: of a run that has made no update.
        folders: one for each agent.
        state_file: where the state is kept between rounds; None to keep none. The transitions are none of it.
    """

    def __init__(
        self,
        pipeline: OfflinePipeline,
        folders: Sequence[OfflineRunFolder],
        state_file: StateFile | None = None,
    ) -> None:
        super().__init__(pipeline, folders, state_file)
        self._pipeline, self._folders = pipeline, folders
        self._sample = _spread_sample(pipeline)

    @property
    def updates(self) -> int:
        """Updates of each agent's network so far."""
        return self._pipeline.learner.updates

    def run(self, on_round: Callable[["OfflineTrainer"], None]) -> None:
        """Trains and evaluates; `on_round` is called after every so many updates.

        Raises:
            CarrlError: a table or a checkpoint cannot be written, or a loss is not a number.
        """
        limit = self._pipeline.offline_plan.updates
        if self.updates == 0:
            self.save()
        while self.updates < limit and not self.stopping:
            self._pipeline.learner.learn(min(UPDATES_PER_ROUND, limit - self.updates))
            self._note()
            on_round(self)
            self._end_round()
        self.save()
        if self.stopping:
            for run in self.runs:
                run.keep_network("last", run.moment)
        else:
            self._evaluate()

    def _note(self) -> None:
        """Measures every agent's progress."""
        self._check_losses(range(len(self.runs)))
        losses = self._pipeline.learner.losses.tolist()
        values = zip(losses, *self._mean_values(), strict=True)
        for run, folder, (loss, logged, greedy, agreement) in zip(self.runs, self._folders, values, strict=True):
            run.moment = Moment(frames=0, updates=self.updates, epsilon=0.0, loss=loss, wall_time_s=self.wall_time_s)
            folder.add_learnt(
                Learnt(
                    updates=self.updates,
                    loss=loss,
                    td_error=td_error(run.agent, self._sample),
                    logged_value=logged,
                    greedy_value=greedy,
                    agreement=agreement,
                    wall_time_s=self.wall_time_s,
                )
            )

    def _mean_values(self) -> list[list[float]]:
        """Mean values of the logged and of the greedy actions, and how often they are the same; each for A agents."""
        agents, sample = len(self.runs), self._sample
        values = self._pipeline.policy.action_values(sample["observation"].repeat(agents, 1))
        values = values.view(agents, len(sample), -1)
        logged = sample["action"].expand(agents, -1)
        greedy_value, greedy = values.max(dim=-1)
        logged_value = values.gather(-1, logged[..., None])[..., 0]
        means: list[list[float]] = (
            torch.stack([logged_value, greedy_value, (greedy == logged).float()]).mean(-1).tolist()
        )
        return means

    def _evaluate(self) -> None:
        world = self._pipeline.world
        trials = self._drive(world.simulator(world.circuits.validation, self._sample["observation"].device))
        for run, trial in zip(self.runs, trials, strict=True):
            run.add_evaluation(trial, run.moment)


def _spread_sample(pipeline: OfflinePipeline) -> TensorDictBase:
    """The transitions [P] to measure, the same for all agents."""
    storage = pipeline.replay_buffer.storage
    items = torch.linspace(0, len(storage) - 1, min(SAMPLE_SIZE, len(storage))).long()
    return storage.get(items)[:, 0].clone()
