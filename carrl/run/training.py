"""What every way of training has in common: agents' runs, the time they take, and an early end."""

import time
from collections.abc import Sequence

import torch

import carrl
from carrl.run.agent_run import AgentRun
from carrl.run.build import Learning
from carrl.run.evaluation import drive_from
from carrl.run.folder import RunFolder
from carrl.run.trial import Trial
from carrl.sim.simulator import Simulator


class Training:
    """Agents that learn side by side, and when they began to.

    Args:
        learning: the agents and what trains them.
        folders: one for each agent.

    Attributes:
        runs: of the agents.
    """

    def __init__(self, learning: Learning, folders: Sequence[RunFolder]) -> None:
        self._learning = learning
        self._began = time.monotonic()
        self._stopping = False
        self.runs = [AgentRun(agent, folder) for agent, folder in zip(learning.agents, folders, strict=True)]

    @property
    def wall_time_s(self) -> float:
        """Seconds since the training was made."""
        return time.monotonic() - self._began

    @property
    def start_up_s(self) -> float:
        """Seconds from the first import of CarRL to the training's making: all of a process but its first instant."""
        return self._began - carrl._IMPORTED_AT

    @property
    def first_update_s(self) -> float | None:
        """Seconds from the training's making to its first update, compilation included; None before that."""
        first = self._learning.learner.first_update_at
        return None if first is None else first - self._began

    def stop(self) -> None:
        """Ends all runs after the present round, with everything saved."""
        self._stopping = True

    def _drive(self, simulator: Simulator) -> list[Trial]:
        """A greedy lap of every validation circuit from its start line with every agent's network, side by side."""
        circuits = len(self._learning.world.circuits.validation)
        track = torch.arange(circuits).repeat(len(self.runs))
        policy = self._learning.policy.actions
        drives = drive_from(simulator, self._learning.world.reward, policy, torch.zeros(len(track)), track)
        return [Trial(tuple(drives[begin : begin + circuits])) for begin in range(0, len(drives), circuits)]
