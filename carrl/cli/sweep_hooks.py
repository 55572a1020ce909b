"""What conf/train.yaml names for sweeps, and so every `carrl train` imports; hence nothing here waits for torch.

A process that runs jobs imports this module before Hydra composes their configurations.
"""

import os
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from carrl.run.sweep import SweepFolder, job_name

OmegaConf.register_new_resolver("carrl.job_name", job_name, replace=True)


class Beginning(Callback):
    """Tells this process where Hydra puts the sweep, and makes the folder ready, before its first job.

    Attributes:
        folder: of the sweep that this process has begun; None in one that only runs jobs.
    """

    folder: SweepFolder | None = None

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the folder ready."""
        Beginning.folder = SweepFolder(Path(os.path.abspath(config.hydra.sweep.dir)))
        Beginning.folder.begin()
