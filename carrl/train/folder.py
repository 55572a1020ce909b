"""A run's folder while the run is in progress, and the policy that a run has left in its own."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import torch
from tensordict import TensorDictBase

from carrl.algorithms.common.policy import GreedyPolicy
from carrl.errors import CheckpointError
from carrl.evaluation.results import Trial
from carrl.evaluation.rollout import Policy
from carrl.files import remove_left_overs
from carrl.log.messages import Episode, Metrics
from carrl.log.writer import LogWriter
from carrl.task.world import World
from carrl.train.build import build_network
from carrl.train.checkpoint import load_checkpoint, save_checkpoint
from carrl.train.divergence import REPORT as DIVERGENCE
from carrl.train.files import CONFIG, EVALUATIONS, METRICS, SUMMARY, checkpoint_path, write_text
from carrl.train.moment import Moment
from carrl.train.scalars import Scalars
from carrl.train.settings import put_back, read_settings
from carrl.train.table import Table, check_table

EPISODE_FIGURES = ("episode", "frame", "env", "episode_return", "length", "gates", "laps", "ended")
"""What `metrics.csv` tells of an episode."""


def check_tables(path: Path, state: Mapping[str, Any]) -> None:
    """Checks that the tables in a run's folder say what they said at this state, before anything is written.

    Raises:
        CarrlError: one says otherwise, or cannot be read.
    """
    for name in (METRICS, EVALUATIONS):
        try:
            check_table(path / name, state["tables"][name])
        except OSError as error:
            raise CheckpointError(f"'{path / name}' cannot be read: {error.strerror}; move it away") from error


class RunFolder:
    """The folder of a run in progress; use it in a `with` statement, so that its files are completed.

    Args:
        path: of the folder.
        recorder: of the run's log, if it has one.
        state: `state_dict` of the folder of a run that was broken off, to go on with it from there.
        scalars: takes the figures of the tables, too.

    Raises:
        CarrlError: the folder cannot be written.
    """

    def __init__(
        self,
        path: Path,
        recorder: LogWriter | None = None,
        state: Mapping[str, Any] | None = None,
        scalars: Scalars | None = None,
    ) -> None:
        """Opens the tables."""
        self.path = path
        self._recorder, self._scalars = recorder, scalars
        self._settings = read_settings(path)
        remove_left_overs(path, path / "checkpoints", (path / CONFIG).parent)
        tables = state["tables"] if state else {METRICS: "", EVALUATIONS: ""}
        self._metrics = Table(path / METRICS, tables[METRICS])
        self._evaluations = Table(path / EVALUATIONS, tables[EVALUATIONS])

    def __enter__(self) -> Self:
        """Returns the folder itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the log and the tables, also after an error."""
        self._metrics.close()
        self._evaluations.close()
        if self._scalars is not None:
            self._scalars.close()
        if self._recorder is not None:
            self._recorder.close()

    def state_dict(self) -> dict[str, Any]:
        """How far the log is written, and what the tables say.

        Raises:
            LogError: the disk fails.
        """
        return {
            "log": self._recorder.state_dict() if self._recorder else None,
            "tables": {METRICS: self._metrics.text, EVALUATIONS: self._evaluations.text},
        }

    @property
    def is_gone(self) -> bool:
        """Whether the folder was deleted or moved."""
        return not self._metrics.is_in_place

    def put_back(self) -> None:
        """Makes the folder anew after it was deleted or moved, with all but the checkpoints; the log is closed then.

        Raises:
            CarrlError: the disk fails.
        """
        put_back(self._settings)
        self._metrics.put_back()
        self._evaluations.put_back()
        if self._recorder is not None:
            self._recorder.put_back()

    @property
    def takes_metrics(self) -> bool:
        """Whether `add_metrics` has any use for them."""
        return self._recorder is not None or self._scalars is not None

    def record(self, transitions: TensorDictBase) -> None:
        """Logs transitions [F]."""
        if self._recorder is not None:
            self._recorder.write(transitions)

    def add_metrics(self, metrics: Metrics) -> None:
        """Logs how learning goes after the transitions logged so far."""
        if self._recorder is not None:
            self._recorder.write_metrics(metrics)
        self._add_scalars("training", metrics.frame, metrics._asdict())

    def flush(self) -> None:
        """Hands what was logged to the operating system, where it outlives this process."""
        if self._recorder is not None:
            self._recorder.flush()

    def add_episode(self, episode: Episode, recent_return: float, moment: Moment) -> None:
        """Logs an ended episode and adds a row to `metrics.csv`."""
        if self._recorder is not None:
            self._recorder.write_episode(episode)
        self._metrics.append(
            {
                **{name: getattr(episode, name) for name in EPISODE_FIGURES},
                "mean_return_20": round(recent_return, 3),
                "epsilon": round(moment.epsilon, 6),
                "loss": moment.loss,
                "updates": moment.updates,
                "wall_time_s": round(moment.wall_time_s, 3),
            }
        )
        figures = {"return": episode.episode_return, "mean_return_20": recent_return}
        self._add_scalars("episode", episode.frame, figures | {"length": episode.length, "gates": episode.gates})

    def add_evaluation(self, attempt: Trial, frames: int, episodes: int) -> None:
        """Adds a row to `evaluations.csv`."""
        self._evaluations.append({"frames": frames, "episodes": episodes, **attempt.measures()})
        self._add_scalars("evaluation", frames, attempt.measures())

    def _add_scalars(self, group: str, step: int, values: Mapping[str, Any]) -> None:
        if self._scalars is not None:
            self._scalars.add(group, step, values)

    def save_checkpoint(self, name: str, state: Mapping[str, Any]) -> None:
        """Writes `checkpoints/NAME.pt`."""
        save_checkpoint(checkpoint_path(self.path, name), dict(state))

    def write_divergence(self, report: Mapping[str, Any]) -> None:
        """Writes `divergence.json`."""
        write_text(self.path / DIVERGENCE, json.dumps(report, indent=2) + "\n")

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Writes `summary.json`."""
        write_text(self.path / SUMMARY, json.dumps(summary, indent=2) + "\n")


def load_greedy_policy(run: Path, checkpoint: str, config: dict[str, Any], world: World) -> Policy:
    """The greedy policy of a run's `best` or `last` network.

    Raises:
        CheckpointError: the checkpoint is missing, damaged, or of another network than the configuration's.
    """
    path = checkpoint_path(run, checkpoint)
    state = load_checkpoint(path).get("network")
    network = build_network(config, world)
    if not _fits(state, network.state_dict()):
        raise CheckpointError(f"checkpoint '{path}' does not fit the network in {run / CONFIG}")
    network.load_state_dict(state)
    return GreedyPolicy([network]).actions


def _fits(state: object, wanted: Mapping[str, torch.Tensor]) -> bool:
    """Whether these are the network's parameters, by name, type and shape, all of them finite numbers."""
    return (
        isinstance(state, dict)
        and state.keys() == wanted.keys()
        and all(isinstance(state[name], torch.Tensor) and _alike(state[name], own) for name, own in wanted.items())
    )


def _alike(found: torch.Tensor, wanted: torch.Tensor) -> bool:
    kinds = (found.layout, found.dtype, found.device, found.shape)
    return kinds == (wanted.layout, wanted.dtype, wanted.device, wanted.shape) and bool(found.isfinite().all())
