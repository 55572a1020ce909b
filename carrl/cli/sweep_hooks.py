"""What conf/train.yaml names for the folders of runs and sweeps.

Every `carrl train` imports it, hence nothing here waits for torch. A process that runs jobs imports this module before
Hydra composes their configurations.
"""

import os
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from carrl.errors import CarrlError
from carrl.train.lock import locked
from carrl.train.new_folder import check_is_in_no_run, make_new
from carrl.train.sweep import SweepFolder, job_name

OmegaConf.register_new_resolver("carrl.job_name", job_name, replace=True)


class Refusal(BaseException):
    """Carries an error past Hydra, which turns every `Exception` of a callback into a warning and goes on."""

    def __init__(self, error: CarrlError) -> None:
        super().__init__(str(error))
        self.error = error


class Beginning(Callback):
    """Makes the folder of a run or a sweep ready before Hydra writes to it, a new one where none was named.

    Attributes:
        folder: of the sweep that this process has begun; None in one that only runs jobs.
        lock: on that folder, until it is closed.
    """

    folder: SweepFolder | None = None
    lock = ExitStack()

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the run's folder."""
        with suppress(CarrlError):  # Hydra cannot write there either, and says so
            _choose_folder("run", config)

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the sweep's folder and lets nobody else begin a sweep in it."""
        try:
            _choose_folder("sweep", config)
            folder = SweepFolder(Path(os.path.abspath(config.hydra.sweep.dir)))
            check_is_in_no_run(folder.path)
            Beginning.lock.enter_context(locked(folder.path))
            folder.begin()
        except CarrlError as error:
            raise Refusal(error) from error
        Beginning.folder = folder


def _choose_folder(kind: str, config: DictConfig) -> None:
    """Makes a new folder by the configured name or one like it, unless it was named in the command."""
    key, given = f"hydra.{kind}.dir", config.hydra.overrides.hydra
    typed: Any = OmegaConf.to_container(given, resolve=False)  # one may be ${hydra.job.num}, which only jobs have
    if any(str(override).lstrip("+").startswith(f"{key}=") for override in typed):
        return
    folder = str(make_new(Path(config.hydra[kind].dir)))
    with read_write(config), open_dict(config):
        config.hydra[kind].dir = folder
        given.append(f"{key}={folder}")  # from which the configurations of a sweep's jobs are made
