"""Hydra's configuration as plain values, checked: everything in it is read by something."""

from collections.abc import Sequence
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from carrl.cli.known_keys import check_keys, explain
from carrl.config import config_dir
from carrl.errors import ConfigError


def plain(config: DictConfig) -> dict[str, Any]:
    """The configuration as plain values.

    Raises:
        ConfigError: a value is missing or refers to none, or a key is known to nobody.
    """
    try:
        missing = sorted(OmegaConf.missing_keys(config))
        if missing:
            raise ConfigError(f"{missing[0]} has no value; give it one, as in carrl train ... {missing[0]}=FILE")
        values: dict[str, Any] = OmegaConf.to_container(config, resolve=True)  # type: ignore[assignment]
    except OmegaConfBaseException as error:
        raise ConfigError(explain(error)) from error
    check_keys(values)
    return values


def composed(overrides: Sequence[str], name: str = "train") -> dict[str, Any]:
    """The resolved configuration with these overrides.

    Raises:
        ConfigError: there is none.
    """
    try:
        with initialize_config_dir(str(config_dir()), version_base="1.3"):
            return plain(compose(name, list(overrides)))
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(explain(error)) from error
