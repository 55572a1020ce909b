"""Hydra's records of how a run was asked for, which Hydra itself would write before anything is checked."""

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from carrl.errors import CarrlError
from carrl.train.files import CONFIG, write_text

HYDRA, OVERRIDES = CONFIG.with_name("hydra.yaml"), CONFIG.with_name("overrides.yaml")


def write_records(run: Path) -> None:
    """Writes `.hydra/hydra.yaml` and `.hydra/overrides.yaml` as Hydra does; to be called from one of its jobs.

    Raises:
        CarrlError: the folder cannot be written.
    """
    try:
        (run / CONFIG).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CarrlError(f"the run's folder '{run}' cannot be written: {error.strerror}") from error
    write_text(run / HYDRA, OmegaConf.to_yaml(HydraConfig.instance().cfg))
    write_text(run / OVERRIDES, OmegaConf.to_yaml(HydraConfig.get().overrides.task))
