"""Composes configurations as the command line does."""

from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from omegaconf import OmegaConf

from carrl.config import config_dir


def compose(*overrides: str) -> dict[str, Any]:
    """The resolved configuration with these overrides, as plain values; without compilation unless they ask for it."""
    with initialize_config_dir(str(config_dir()), version_base="1.3"):
        config = hydra_compose("train", ["compile=false", *overrides])
    values: dict[str, Any] = OmegaConf.to_container(config, resolve=True)
    return values
