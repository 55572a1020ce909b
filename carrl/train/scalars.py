"""A run's figures through TorchRL's loggers, beside its tables: for TensorBoard, Weights & Biases and MLflow.

The packages are extras, imported only here and only when asked for. Nothing of a logger reaches the training: figures
are handed over as they come, written together now and then, and a logger that fails is let go of with a warning.
"""

import logging
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from carrl.errors import ConfigError

_logger = logging.getLogger(__name__)
WRITTEN_WITHIN_S = 0.5
"""Wall time after which figures are written at the next chance."""


class Row(NamedTuple):
    """Figures that belong together.

    Attributes:
        step: env steps of the replicate when they came up; updates, where it learns from logs.
        values: finite numbers by name.
        time_ms: when that was, ms since 1970.
    """

    step: int
    values: Mapping[str, float]
    time_ms: int


class Scalars:
    """One replicate's figures on their way to a logger.

    Args:
        logger: of TorchRL.
        config: of the run, to be noted as its hyperparameters; None if they are already.
        write: writes many rows at once; by default one after the other.
        close: ends the logger's run.
    """

    def __init__(
        self,
        logger: Any,
        config: Mapping[str, Any] | None,
        write: Callable[[Sequence[Row]], None] | None = None,
        close: Callable[[], None] | None = None,
    ) -> None:
        self._logger = logger
        self._write, self._close = write or self._write_one_by_one, close or logger.close
        self._rows: list[Row] = []
        self._written_at = time.monotonic()
        self._works = True
        if config is not None:
            self._guarded(lambda: logger.log_hparams(_flat(config)))

    def add(self, group: str, step: int, values: Mapping[str, Any]) -> None:
        """Notes figures, as `group/name`; those that are no finite numbers are left out."""
        numbers = {f"{group}/{name}": float(value) for name, value in values.items() if isinstance(value, int | float)}
        finite = {name: value for name, value in numbers.items() if math.isfinite(value)}
        self._rows.append(Row(step, finite, time.time_ns() // 1_000_000))
        if time.monotonic() >= self._written_at + WRITTEN_WITHIN_S:
            self._flush()

    def close(self) -> None:
        """Writes what is left."""
        self._flush()
        self._guarded(self._close)

    def _flush(self) -> None:
        rows, self._rows, self._written_at = self._rows, [], time.monotonic()
        if rows:
            self._guarded(lambda: self._write(rows))

    def _write_one_by_one(self, rows: Sequence[Row]) -> None:
        for row in rows:
            self._logger.log_metrics(row.values, step=row.step)

    def _guarded(self, act: Callable[[], object]) -> None:
        if self._works:
            try:
                act()
            except Exception as error:  # a full disk, a server that is gone: each package has errors of its own
                self._works = False
                _logger.warning("%s failed, and gets no more figures: %s", type(self._logger).__name__, error)


def make_tensorboard(*, folder: Path, config: Mapping[str, Any]) -> Scalars:
    """Event files in the run's folder.

    Raises:
        ConfigError: the package is not installed.
    """
    _check_installed("tensorboard")
    from torchrl.record.loggers import TensorboardLogger

    return Scalars(TensorboardLogger("tensorboard", log_dir=str(folder)), config)


def make_wandb(project: str, offline: bool, *, folder: Path, config: Mapping[str, Any]) -> Scalars:
    """A run of Weights & Biases, kept in the run's folder and, unless `offline`, sent to its server.

    Args:
        project: of the runs, on the server.
        offline: keep them here, for `wandb sync RUN/wandb/offline-run-*`; else send them while training, after `wandb
            login`.
        folder: of the run.
        config: of the run.

    Raises:
        ConfigError: the package is not installed, or the server refuses the run.
    """
    _check_installed("wandb")
    import wandb
    from torchrl.record.loggers import WandbLogger

    try:
        logger = WandbLogger(
            _name_of(folder),
            offline=offline,
            save_dir=folder,
            project=project,
            log_env_packages=False,
            reinit="create_new",  # side by side with the runs of other replicates
            settings=wandb.Settings(console="off", silent=True),
        )
    except wandb.Error as error:
        raise ConfigError(f"logger=wandb: {error}; run wandb login, or set logger.offline=true") from error
    return Scalars(logger, config)


def make_mlflow(experiment: str, tracking_uri: str | None, *, folder: Path, config: Mapping[str, Any]) -> Scalars:
    """A run of MLflow, by default in a database in the run's folder.

    Args:
        experiment: the name under which MLflow lists the runs.
        tracking_uri: one place for many runs, such as sqlite:////home/me/mlflow.db or a server; None for a file in the
            run's folder.
        folder: of the run.
        config: of the run.

    Raises:
        ConfigError: the package is not installed, or the place cannot be reached.
    """
    _check_installed("mlflow")
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    import mlflow
    from mlflow.entities import Metric
    from torchrl.record.loggers import MLFlowLogger

    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.WARNING)
    uri = tracking_uri or f"sqlite:///{folder.absolute()}/mlflow.db"
    artifacts = None if tracking_uri else (folder.absolute() / "mlartifacts").as_uri()
    try:
        logger = MLFlowLogger(experiment, uri, artifact_location=artifacts)
        client, run = mlflow.MlflowClient(uri), logger.experiment.info.run_id
        logger.log_hparams(_flat(config))
        mlflow.end_run()  # of the process, which has one at a time; other replicates have runs of their own
        client.update_run(run, status="RUNNING", name=_name_of(folder))
    except Exception as error:  # of MLflow, of SQLAlchemy, of the network
        raise ConfigError(f"logger=mlflow: '{uri}' cannot be used: {' '.join(str(error).split())}") from error

    def write(rows: Sequence[Row]) -> None:  # log_metrics of TorchRL's logger takes ten milliseconds a row
        metrics = [Metric(name, value, row.time_ms, row.step) for row in rows for name, value in row.values.items()]
        for start in range(0, len(metrics), 1000):  # the most that MLflow takes at once
            client.log_batch(run, metrics[start : start + 1000])

    return Scalars(logger, None, write, lambda: client.set_terminated(run))


def _check_installed(package: str) -> None:
    if find_spec(package) is None:
        raise ConfigError(f"logger={package} needs {package}; pip install 'carrl[{package}]'")


def _name_of(folder: Path) -> str:
    """The last two parts of the run's folder, since one alone is but a time or a seed."""
    return "/".join(folder.absolute().parts[-2:])


def _flat(node: Mapping[str, Any], above: str = "") -> dict[str, int | float | str | bool]:
    """A nested configuration as dotted keys to values that every logger takes."""
    leaves: dict[str, int | float | str | bool] = {}
    for key, value in node.items():
        if isinstance(value, Mapping):
            leaves |= _flat(value, f"{above}{key}.")
        else:
            leaves[f"{above}{key}"] = value if isinstance(value, int | float | str | bool) else str(value)
    return leaves
