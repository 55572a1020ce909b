"""A run's folder: what is in it, written and read in one place.

.hydra/config.yaml    the resolved configuration
train.mcap            every transition
checkpoints/          best.pt and last.pt
metrics.csv           a row for each ended episode
evaluations.csv       a row for each greedy drive during training
summary.json          the run in a few figures
learning_curve.png, lap.png
"""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml
from tensordict import TensorDictBase

from carrl.errors import CarrlError, CheckpointError
from carrl.files import write_whole
from carrl.record.messages import Episode, Metrics
from carrl.record.writer import LogWriter
from carrl.run.build import build_network, observes_action
from carrl.run.checkpoint import load_checkpoint, save_checkpoint
from carrl.run.evaluation import Policy, greedy_policy
from carrl.run.moment import Moment
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


class RunFolder:
    """The folder of a run in progress; use it in a `with` statement, so that its files are completed."""

    def __init__(self, path: Path, recorder: LogWriter | None = None) -> None:
        """Opens the tables.

        Raises:
            CarrlError: the folder cannot be written.
        """
        self.path = path
        self._recorder = recorder
        self._metrics = _Table(path / METRICS)
        self._evaluations = _Table(path / EVALUATIONS)

    def __enter__(self) -> Self:
        """Returns the folder itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the log and the tables, also after an error."""
        self._metrics.close()
        self._evaluations.close()
        if self._recorder is not None:
            self._recorder.close()

    @property
    def has_log(self) -> bool:
        """Whether transitions are logged at all."""
        return self._recorder is not None

    def record(self, transitions: TensorDictBase) -> None:
        """Logs transitions [F]."""
        if self._recorder is not None:
            self._recorder.write(transitions)

    def add_metrics(self, metrics: Metrics) -> None:
        """Logs how learning goes after the transitions logged so far."""
        if self._recorder is not None:
            self._recorder.write_metrics(metrics)

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

    def add_evaluation(self, attempt: Trial, frames: int, episodes: int) -> None:
        """Adds a row to `evaluations.csv`."""
        self._evaluations.append({"frames": frames, "episodes": episodes, **attempt.measures()})

    def save_checkpoint(self, name: str, state: Mapping[str, Any]) -> None:
        """Writes `checkpoints/NAME.pt`."""
        save_checkpoint(checkpoint_path(self.path, name), dict(state))

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Writes `summary.json`."""
        write_text(self.path / SUMMARY, json.dumps(summary, indent=2) + "\n")


def checkpoint_path(run: Path, name: str) -> Path:
    """Where a run keeps the checkpoint of this name, `best` or `last`."""
    return run / "checkpoints" / f"{name}.pt"


def seed_folders(run: Path) -> list[Path]:
    """The folders of a run's seeds in their order, where it has several; else the run's own."""
    found = [path.parents[1] for path in run.glob(f"seed=*/{CONFIG}") if path.parents[1].name[5:].isdecimal()]
    return sorted(found, key=lambda folder: int(folder.name[5:])) or [run]


def load_config(run: Path) -> dict[str, Any]:
    """The resolved configuration of a run, as plain values.

    Raises:
        CheckpointError: this is no run's folder, or its configuration is damaged.
    """
    if not run.is_dir():
        raise CheckpointError(f"run '{run}' is not a folder; name a run's, such as outputs/2026-01-31/12-00-00")
    try:
        config = yaml.safe_load(read_text(run / CONFIG))
    except yaml.YAMLError as error:
        raise CheckpointError(f"run '{run}': {CONFIG} is not YAML") from error
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
    try:
        network.load_state_dict(state)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise CheckpointError(f"checkpoint '{path}' does not fit the network in {run / CONFIG}") from error
    return greedy_policy(network, observes_action(config))


def read_text(path: Path) -> str:
    """The text of a run's file, bounded in size.

    Raises:
        CheckpointError: the file is missing, too large or no text.
    """
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise CheckpointError(f"'{path}' is larger than {MAX_TEXT_BYTES} bytes")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise CheckpointError(f"'{path}' does not exist; a run's folder has it") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CheckpointError(f"'{path}' cannot be read: {error}") from error


def write_text(path: Path, text: str) -> None:
    """Writes a file whole or not at all.

    Raises:
        CarrlError: the disk refuses it.
    """
    write_whole(path, text.encode())


class _Table:
    """A CSV file that grows row by row; its header is the first row's keys."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: csv.DictWriter[str] | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("w", newline="", encoding="utf-8", buffering=1)
        except OSError as error:
            raise self._unwritable(error) from error

    def append(self, row: Mapping[str, Any]) -> None:
        try:
            if self._writer is None:
                self._writer = csv.DictWriter(self._file, list(row))
                self._writer.writeheader()
            self._writer.writerow(row)
        except OSError as error:
            raise self._unwritable(error) from error

    def close(self) -> None:
        try:
            self._file.close()
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> CarrlError:
        return CarrlError(f"'{self._path}' cannot be written: {error.strerror}")
