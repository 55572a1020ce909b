"""Keeps what the first entrant's car drives in each race, as `carrl.evaluation.drive_log` keeps other drives.

Shapes: `W` races, `B` cars in all of them.
"""

from dataclasses import replace

import torch
from torch import Tensor

from carrl.evaluation.driver import Decision
from carrl.evaluation.race_grid import Grid
from carrl.evaluation.rollout import DrivenStep, Policy, Recorder
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.task.end import End, EndAtCarContact, EndAtContact
from carrl.task.episode import EpisodeState, StepContext
from carrl.task.task import SENSOR_SEED, StepResult, Task, World


class RaceRecording:
    """The first car of each race as drives of its own, with the other cars beside it.

    Args:
        recorder: what keeps them.
        world: as the car's policy sees it.
        policy: that drives it.
        grid: of the races.
    """

    def __init__(self, recorder: Recorder, world: World, policy: Policy, grid: Grid) -> None:
        self._recorder, self._grid, self._traffic = recorder, grid, grid.traffic
        count = grid.traffic.cars_per_world
        self._leads, self._rows = slice(None, None, count), slice(None, None, 1 if grid.traffic.opponents else count)
        alone = Simulator(grid.traffic.tracks, world.vehicle, world.sensor)
        self._task = Task(
            alone,
            len(grid.behind) // count,
            [SENSOR_SEED],
            action=world.action,
            observation=world.observation,
            reward=world.reward,
            end=End({"wall": EndAtContact(), "cars": EndAtCarContact()}),
        )
        self._last_action = world.action.first.expand(self._task.cars, *world.action.first.shape).clone()
        recorder.begin(self._task, policy)

    def add(
        self,
        number: int,
        rows: CarState,
        outcome: Outcome,
        decisions: tuple[Decision, Decision],
        drives: Tensor,
        goes_on: Tensor,
        is_out: Tensor,
    ) -> None:
        """Keeps a step.

        Args:
            number: of the step, from 1.
            rows: the grid's, before it.
            outcome: of these, with their places.
            decisions: of the car's driver before and after it, for all cars [B].
            drives: which cars made the step, [B], bool.
            goes_on: which of them make another one, [B], bool.
            is_out: which of them have touched something that takes them off the road, [B], bool.
        """
        before, after = self._lead(rows), self._lead(outcome.cars)
        own = replace(replace(outcome, cars=replace(outcome.cars, others=None))[self._rows], cars=after)
        action, step = decisions[0].action[self._leads], torch.full_like(before.next_gate, number - 1)
        state = EpisodeState(before, step, self._last_action, contact=torch.zeros_like(own.collided))
        terms = self._task.reward(StepContext(state, action, own, self._traffic, self._task.action))
        self._last_action = action
        told, told_then = (decision.observation[self._leads] for decision in decisions)
        drives, goes_on, is_out = (each[self._leads] for each in (drives, goes_on, is_out))
        then = EpisodeState(after, step + 1, action, contact=own.collided)
        result = StepResult(then, told_then, terms, drives & is_out, drives & ~goes_on & ~is_out, own)
        self._recorder.add(DrivenStep(state, told, action, result, drives, goes_on))

    def _lead(self, rows: CarState) -> CarState:
        """The first car of each race, with the others of its world."""
        if rows.others is not None:
            return rows
        return replace(rows[self._rows], others=self._traffic.neighbours(rows)[self._rows])
