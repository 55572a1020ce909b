"""Hydra's configuration as plain values."""

from typing import Any

from omegaconf import DictConfig, OmegaConf

from carrl.errors import ConfigError


def plain(config: DictConfig) -> dict[str, Any]:
    """The configuration as plain values.

    Raises:
        ConfigError: a value is missing.
    """
    missing = sorted(OmegaConf.missing_keys(config))
    if missing:
        raise ConfigError(f"{missing[0]} has no value; give it one, as in carrl train ... {missing[0]}=FILE")
    values: dict[str, Any] = OmegaConf.to_container(config, resolve=True)  # type: ignore[assignment]
    return values
