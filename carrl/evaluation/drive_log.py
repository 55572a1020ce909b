"""Keeps drives without exploration as a log, in the format of training's."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import torch
from tensordict import TensorDict
from torch import Tensor

from carrl.data.description import attachments, describe_run, log_schema
from carrl.evaluation.rollout import DrivenStep, Policy
from carrl.log.messages import Episode, how_ended
from carrl.log.writer import LogWriter
from carrl.sim.simulator import CarState
from carrl.task.task import StepResult, Task
from carrl.tracks.track import Track

WRITTEN_TOGETHER = 2048
"""Transitions."""


class DriveLog:
    """A log of the drives of one policy; use it in a `with` statement. The file appears with the first drive.

    Each drive is an episode, and has a car of its own with the same number. They are numbered as they are evaluated:
    those of the first track from its start line on, then those of the next one. A drive that ends with its last lap, or
    as its time is up, is truncated.

    Args:
        path: the file to write.
        config: the resolved configuration, as YAML.
        tracks: that are driven, in their order.
        drives: how many, on all of them.
        seed: of the run.
        entries: what else to say of the drives.
        others: how many cars there are beside each that is driven; by default the task's opponents.

    Raises:
        LogError: the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        config: str,
        tracks: Sequence[Track],
        drives: int,
        seed: int,
        entries: Mapping[str, str],
        others: int | None = None,
    ) -> None:
        self._path, self._tracks, self._drives, self._seed = path, tracks, drives, seed
        self._config, self._entries, self._others = config, entries, others
        self._writer: LogWriter | None = None
        self._waiting: list[TensorDict] = []
        self._task: Task | None = None
        self._policy: Policy | None = None
        self._frames = self._begin_ns = self._now_ns = 0
        self._first_drive = self._first_track = 0

    def __enter__(self) -> Self:
        """Returns the log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the file, also after an error."""
        if self._writer is not None:
            try:
                self._write_waiting()
            finally:
                self._writer.close()

    def begin(self, task: Task, policy: Policy) -> None:
        """Goes on with the drives of a task, all of whose cars start now."""
        if self._task is not None:
            self._first_drive += self._task.cars
            self._first_track += len(self._task.simulator.tracks)
        self._task, self._policy, self._begin_ns = task, policy, self._now_ns
        self._return = torch.zeros(task.cars, dtype=torch.float64)
        if self._writer is None:
            columns = getattr(policy, "log_columns", None)
            self._schema = log_schema(task, columns(task.action.names) if columns else (), self._others)
            self._writer = LogWriter(
                self._path,
                schema=self._schema,
                attachments=attachments(self._config, self._tracks),
                metadata={**describe_run(task, self._seed, self._drives, self._tracks), **self._entries},
            )

    def add(self, step: DrivenStep) -> None:
        """Keeps a step of the cars that drive, and the episodes that end with it."""
        assert self._task is not None and self._writer is not None
        ended = step.drives & ~step.goes_on
        everyone = TensorDict(self._values(step, ended), batch_size=[len(ended)])
        self._waiting.append(everyone[step.drives].cpu())
        self._now_ns += round(self._task.simulator.vehicle.time_step * 1e9)
        self._frames += len(self._waiting[-1])
        self._return += step.after.reward_terms.double().sum(-1).cpu() * step.drives.cpu()
        if ended.any() or sum(map(len, self._waiting)) >= WRITTEN_TOGETHER:
            self._write_waiting()
        for car in ended.nonzero().flatten().tolist():
            self._writer.write_episode(self._episode(car, step.after))

    def _values(self, step: DrivenStep, ended: Tensor) -> dict[str | tuple[str, ...], Tensor]:
        """What the columns are taken from, of all cars, by the keys of TorchRL."""
        state, after = step.state, step.after
        assert self._task is not None
        collided = self._task.collided(after.state)
        drive = self._first_drive + torch.arange(len(ended), device=ended.device)
        logged, state_key = getattr(self._policy, "logged", None), self._schema.by_name["state"].key
        return {
            "observation": step.observation,
            "action": step.action,
            ("next", "reward"): after.reward_terms.sum(-1, keepdim=True),
            ("next", "reward_terms"): after.reward_terms,
            ("next", "observation"): after.observation,
            ("next", "terminated"): after.terminated[:, None],
            ("next", "truncated"): (ended & ~after.terminated)[:, None],
            "episode": drive,
            "step": state.step,
            "car": drive,
            "track": self._first_track + state.cars.track,
            state_key: state.cars.state,
            ("next", state_key): after.state.cars.state,
            "next_gate": state.cars.next_gate,
            "gates_passed": state.cars.gates_passed,
            ("next", "gates_passed"): after.state.cars.gates_passed,
            "time_ns": torch.full_like(drive, self._now_ns),
            **(logged(step.observation) if logged else {}),
            **({} if collided is None else {("next", "collided"): collided}),
            **_other_poses(state.cars, after.state.cars),
        }

    def _episode(self, car: int, after: StepResult) -> Episode:
        assert self._task is not None
        cars, terminated = after.state.cars, bool(after.terminated[car])
        gates, track = int(cars.gates_passed[car]), int(cars.track[car])
        x, y, heading = cars.pose[car].tolist()
        return Episode(
            episode=self._first_drive + car,
            env=self._first_drive + car,
            track=self._first_track + track,
            frame=self._frames,
            begin_ns=self._begin_ns,
            end_ns=self._now_ns,
            episode_return=float(self._return[car]),
            length=int(after.state.step[car]),
            gates=gates,
            laps=gates // self._task.simulator.tracks[track].gate_count,
            ended=how_ended(terminated, bool(after.outcome.collided[car])),
            end_pose=(x, y, heading),
        )

    def _write_waiting(self) -> None:
        """Writes the transitions since the last call."""
        if self._waiting and self._writer is not None:
            waiting, self._waiting = torch.cat(self._waiting), []
            self._writer.write(waiting)


def _other_poses(before: CarState, after: CarState) -> dict[str | tuple[str, ...], Tensor]:
    """Those of the opponents, [N, 3 M], before and after a step; nothing where there are none."""
    if before.others is None or after.others is None:
        return {}
    return {
        "other_poses": before.others.state[..., :3].flatten(1),
        ("next", "other_poses"): after.others.state[..., :3].flatten(1),
    }
