"""What every way of training has in common: agents' runs, the time they take, an early end, and going on after it."""

import time
from collections.abc import Iterable, Sequence
from typing import Any

import torch

import carrl
from carrl.errors import CarrlError, CheckpointError
from carrl.evaluation.results import Trial
from carrl.evaluation.rollout import rollout
from carrl.sim.simulator import Simulator
from carrl.train.agent_run import AgentRun
from carrl.train.build import Learning
from carrl.train.divergence import describe, sentence
from carrl.train.folder import RunFolder
from carrl.train.state_file import StateFile


class Training:
    """Agents that learn side by side, and when they began to.

    Args:
        learning: the agents and what trains them.
        folders: one for each agent.
        state_file: where the state is kept; None to keep none.

    Attributes:
        runs: of the agents.
    """

    def __init__(self, learning: Learning, folders: Sequence[RunFolder], state_file: StateFile | None = None) -> None:
        self._learning = learning
        self._began = time.monotonic()
        self._start_up_s = self._began - carrl._IMPORTED_AT
        self._stopping = False
        self._state_file = state_file
        self.runs = [AgentRun(agent, folder) for agent, folder in zip(learning.agents, folders, strict=True)]

    @property
    def wall_time_s(self) -> float:
        """Seconds since the training was made, and of the processes that were broken off before, up to their states."""
        return time.monotonic() - self._began

    @property
    def start_up_s(self) -> float:
        """Seconds from the first import of CarRL to the training's making: all of a process but its first instant."""
        return self._start_up_s

    @property
    def first_update_s(self) -> float | None:
        """Seconds from the training's making to its first update, compilation included; None before that."""
        first = self._learning.learner.first_update_at
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
        self._learning.learner.interrupt()

    def state_dict(self) -> dict[str, Any]:
        """All that moves, as tensors and plain values; the logs are on the disk up to here.

        Raises:
            CarrlError: the disk fails.
        """
        return {
            "learner": self._learning.learner.state_dict(),
            "runs": [run.state_dict() for run in self.runs],
            "folders": [run.folder.state_dict() for run in self.runs],
            "wall_time_s": self.wall_time_s,
            "first_update_s": self.first_update_s,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from there; call it before `run`. The folders must have been opened with their parts of the state.

        Raises:
            CheckpointError: the state is that of another run.
        """
        try:
            self._load(state)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, RuntimeError) as error:
            raise CheckpointError(f"the state does not fit the run's configuration: {error}") from error

    def _load(self, state: dict[str, Any]) -> None:
        learner = self._learning.learner
        learner.load_state_dict(state["learner"])
        for run, own in zip(self.runs, state["runs"], strict=True):
            run.load_state_dict(own)
        self._began = time.monotonic() - state["wall_time_s"]
        if state["first_update_s"] is not None:
            learner.first_update_at = self._began + state["first_update_s"]

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

    def _end_round(self) -> None:
        """Looks after the folders and the state between two rounds."""
        self._check_folders()
        if self._state_file is not None and self._state_file.is_due:
            self.save()

    def _check_folders(self) -> None:
        """Ends the training, with all that it has written anew in its place, where a folder was deleted or moved."""
        if self._state_file is None or not any(run.folder.is_gone for run in self.runs):
            return
        state = self.state_dict()
        for run in self.runs:
            run.folder.put_back()
            run.write_checkpoints()
        self._state_file.put_back(state)
        path = self._state_file.run
        raise CarrlError(
            f"the run's folder '{path}' was deleted or moved while it trained; all that the run had is there again: "
            f"go on with carrl train resume={path}"
        )

    def _check_losses(self, indices: Iterable[int], **place: int) -> None:
        """Ends the training where a loss of one of these agents was not finite; `place` says where training is."""
        for index in indices:
            divergence = self._learning.learner.divergences.get(index)
            if divergence is None:
                continue
            run = self.runs[index]
            minibatch = self._learning.replay_buffer.storage.get(torch.tensor(divergence.items))[:, index]
            report = {"seed": run.agent.seed, **place, **describe(divergence, minibatch, run.agent.network)}
            run.folder.write_divergence(report)
            raise CarrlError(sentence(report))

    def _drive(self, simulator: Simulator) -> list[Trial]:
        """A greedy lap of every validation circuit from its start line with every agent's network, side by side."""
        circuits = len(self._learning.world.circuits.validation)
        track = torch.arange(circuits).repeat(len(self.runs))
        policy = self._learning.policy.actions
        drives = rollout(self._learning.world, simulator, policy, torch.zeros(len(track)), track)
        return [Trial(tuple(drives[begin : begin + circuits])) for begin in range(0, len(drives), circuits)]
