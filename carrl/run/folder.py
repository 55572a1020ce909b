"""A run's folder: what is in it, written and read in one place.

.hydra/config.yaml    the resolved configuration
train.mcap            every transition
checkpoints/          best.pt and last.pt; state.pt and the one before, to resume from
metrics.csv           a row for each ended episode
evaluations.csv       a row for each greedy drive during training
summary.json          the run in a few figures
learning_curve.png, lap.png
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import torch
from tensordict import TensorDictBase

from carrl.errors import CheckpointError
from carrl.files import read_whole, remove_left_overs, write_whole
from carrl.plain_yaml import parse_yaml
from carrl.record.messages import Episode, Metrics
from carrl.record.writer import LogWriter
from carrl.run.build import build_network, observes_action
from carrl.run.checkpoint import load_checkpoint, save_checkpoint
from carrl.run.divergence import REPORT as DIVERGENCE
from carrl.run.evaluation import Policy, greedy_policy
from carrl.run.moment import Moment
from carrl.run.scalars import Scalars
from carrl.run.settings import put_back, read_settings
from carrl.run.table import Table
from carrl.run.trial import Trial

CONFIG = Path(".hydra/config.yaml")
LOG = "train.mcap"
METRICS = "metrics.csv"
EVALUATIONS = "evaluations.csv"
SUMMARY = "summary.json"
LEARNING_CURVE = "learning_curve.png"
LAP = "lap.png"
_CONFIG_KEYS = ("track", "vehicle", "sensor", "reward", "env", "network", "seed")
EPISODE_FIGURES = ("episode", "frame", "env", "episode_return", "length", "gates", "laps", "ended")
"""What `metrics.csv` tells of an episode."""
MAX_TEXT_BYTES = 64 * 2**20
MAX_CONFIG_BYTES = 2**18
"""Eighty times what training writes."""


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
        self._metrics = Table(path / METRICS, state["metrics"] if state else 0)
        self._evaluations = Table(path / EVALUATIONS, state["evaluations"] if state else 0)

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
        """How far the log and the tables are written.

        Raises:
            LogError: the disk fails.
        """
        return {
            "log": self._recorder.state_dict() if self._recorder else None,
            "metrics": self._metrics.rows,
            "evaluations": self._evaluations.rows,
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


def checkpoint_path(run: Path, name: str) -> Path:
    """Where a run keeps the checkpoint of this name, `best` or `last`."""
    return run / "checkpoints" / f"{name}.pt"


def seed_folders(run: Path) -> list[Path]:
    """The folders of a run's seeds in their order, where it has several; else the run's own."""
    if not os.path.isdir(run):
        return [run]
    found = [path.parents[1] for path in run.glob(f"seed=*/{CONFIG}") if path.parents[1].name[5:].isdecimal()]
    return sorted(found, key=lambda folder: int(folder.name[5:])) or [run]


def load_config(run: Path) -> dict[str, Any]:
    """The resolved configuration of a run, as plain values.

    Raises:
        CheckpointError: this is no run's folder, or its configuration is damaged.
    """
    if not os.path.isdir(run):  # Path.is_dir raises on a name that is too long or may not be looked up
        raise CheckpointError(f"run '{run}' is not a folder; name a run's, such as outputs/2026-01-31/12-00-00")
    try:
        config = parse_yaml(_read_bytes(run / CONFIG, MAX_CONFIG_BYTES))
    except ValueError as error:
        raise CheckpointError(f"run '{run}': {CONFIG}: {error}") from error
    missing = [key for key in _CONFIG_KEYS if not isinstance(config, dict) or key not in config]
    if missing:
        raise CheckpointError(f"run '{run}': {CONFIG} lacks {', '.join(missing)}; it is not what training wrote")
    return config


def load_greedy_policy(run: Path, checkpoint: str, config: dict[str, Any]) -> Policy:
    """The greedy policy of a run's `best` or `last` network.

    Raises:
        CheckpointError: the checkpoint is missing, damaged, or of another network than the configuration's.
    """
    path = checkpoint_path(run, checkpoint)
    state = load_checkpoint(path).get("network")
    network = build_network(config)
    if not _fits(state, network.state_dict()):
        raise CheckpointError(f"checkpoint '{path}' does not fit the network in {run / CONFIG}")
    network.load_state_dict(state)
    return greedy_policy(network, observes_action(config))


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


def read_text(path: Path) -> str:
    """The text of a run's file, bounded in size.

    Raises:
        CheckpointError: the file is missing, too large, no regular file or no text.
    """
    try:
        return _read_bytes(path, MAX_TEXT_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise CheckpointError(f"'{path}' is no text: {error.reason}") from error


def _read_bytes(path: Path, most: int) -> bytes:
    if not os.path.lexists(path):
        raise CheckpointError(f"'{path}' does not exist; a run's folder has it")
    return read_whole(path, most, f"'{path}'", CheckpointError)


def write_text(path: Path, text: str) -> None:
    """Writes a file whole or not at all.

    Raises:
        CarrlError: the disk refuses it.
    """
    write_whole(path, text.encode())
