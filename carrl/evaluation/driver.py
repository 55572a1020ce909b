"""A trained policy at the wheel of cars in traffic: what it sees with the sensors of its run, and what it does then.

Shapes: `N` cars, all those of some worlds; `O` values of an observation, `C` controls, `Q` entries of a memory.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from carrl.evaluation.rollout import Policy
from carrl.sim.simulator import CarState
from carrl.sim.traffic import Traffic
from carrl.task.episode import EpisodeState, Start
from carrl.task.task import SENSOR_SEED, Task, World
from carrl.tracks.track import Track

_LEAST_GAP = 2.0
"""Of starts, which are made elsewhere."""


class Decision(NamedTuple):
    """What a driver does next.

    Attributes:
        observation: what it is told, [N, O].
        action: what it chooses, [N, ...].
        controls: what that means for the car, [N, C].
        memory: what it has to know a step later, [N, Q].
    """

    observation: Tensor
    action: Tensor
    controls: Tensor
    memory: Tensor


class Driver:
    """A policy that decides for cars in traffic. What it must know of the steps before is a memory, handed in and out.

    Args:
        world: how it learnt to drive: its car, sensor, observation and actions.
        policy: observations to actions.
        tracks: to drive on.
        cars_per_world: of the traffic.
        cars: how many it will decide for at a time, N; any whole worlds where its sensor is exact.

    Attributes:
        traffic: the cars as it sees them, on the CPU.
        task: what it is told of them.
    """

    def __init__(self, world: World, policy: Policy, tracks: Sequence[Track], cars_per_world: int, cars: int) -> None:
        self.traffic = Traffic(tracks, world.vehicle, world.sensor, cars_per_world=cars_per_world, bump=world.bump)
        self.task = Task(
            self.traffic,
            cars,
            [SENSOR_SEED],
            action=world.action,
            observation=world.observation,
            reward=world.reward,
            start=Start(gap=_LEAST_GAP),
            end=world.end,
        )
        self._policy, self._first = policy, world.action.first
        self._seen_size = world.observation_size if "seen" in self.task.carried else 0

    @property
    def memory_size(self) -> int:
        """Entries of a memory: the last action; if a term looks back, whether there was a step, and what was seen."""
        return self._first.numel() + (1 + self._seen_size if self._seen_size else 0)

    def blank_memory(self, cars: int) -> Tensor:
        """The memory at a start, [N, Q]."""
        memory = torch.zeros(cars, self.memory_size)
        memory[:, : self._first.numel()] = self._first.flatten().float()
        return memory

    def decide(
        self, cars: CarState, memory: Tensor, contact: Tensor | None = None, pace: Tensor | None = None
    ) -> Decision:
        """What it does with every car, [N].

        Args:
            cars: with the stations that they had a step before, if those are known.
            memory: [N, Q].
            contact: which of them touched a wall in the step before, [N], bool; None if none did.
            pace: as in `Task.tell`.
        """
        size, none = self._first.numel(), torch.zeros_like(cars.next_gate)
        last_action = memory[:, :size].to(self._first.dtype).view(-1, *self._first.shape)
        state = EpisodeState(cars, none, last_action, contact=none.bool() if contact is None else contact)
        observation = self._observe(state, memory[:, size:], pace)
        with torch.no_grad():
            action = self._policy(observation)
        kept = [action.float().flatten(1) if action.dim() > 1 else action.float()[:, None]]
        if self._seen_size:
            kept += [torch.ones_like(kept[0][:, :1]), observation]
        return Decision(observation, action, self.task.action.controls(action), torch.cat(kept, dim=1))

    def _observe(self, state: EpisodeState, memory: Tensor, pace: Tensor | None) -> Tensor:
        """What it is told of cars, some of which may have just started."""
        if not self._seen_size:
            return self.task.tell(state, pace)
        goes_on = memory[:, :1] > 0
        told = self.task.tell(replace(state, seen=memory[:, 1:]), pace)
        return told if bool(goes_on.all()) else torch.where(goes_on, told, self.task.tell(state, pace))
