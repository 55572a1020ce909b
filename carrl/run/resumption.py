"""What a run that is resumed goes on with: its own configuration, but for what may be changed."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from carrl.errors import CheckpointError, ConfigError, shown
from carrl.run.files import CONFIG, SUMMARY, load_config
from carrl.run.state_file import PREVIOUS, STATE, load_state

CHANGEABLE = (
    "trainer.frames",
    "trainer.episodes",
    "trainer.checkpoint_interval",
    "data.updates",
    "evaluation.interval",
    "optimizer.lr",
    "collector.workers",
    "collector.address",
)
"""What may be given anew: how long, how often, how large the steps are, and which cluster drives."""


def resumed_config(run: Path, overrides: Sequence[str]) -> dict[str, Any]:
    """The run's configuration with these overrides, such as `trainer.frames=500000`.

    Raises:
        CarrlError: this is no run's folder, or one that cannot be resumed, or an override is none or not allowed.
    """
    config = load_config(run)
    if not (run / STATE).exists() and not (run / PREVIOUS).exists():
        _check_is_whole_run(run)
    changes = _parsed(run, overrides)
    _check_cluster(run, config, changes)
    for key, value in changes.items():
        *groups, name = key.split(".")
        node = config
        for group in groups:
            node = node.get(group) or {}
        if name not in node and key != "trainer.checkpoint_interval":  # which runs of older versions do not have
            raise ConfigError(f"run '{run}' has no {key} to be changed")
        node[name] = value
    return config


def resumed_state(run: Path, config: Mapping[str, Any]) -> dict[str, Any] | None:
    """The run's latest state; None if it was broken off before it had any, and is to begin anew.

    Raises:
        CheckpointError: it is damaged, or was made with another configuration.
    """
    if not (run / STATE).exists() and not (run / PREVIOUS).exists():
        _check_is_whole_run(run)
        return None
    state = load_state(run)
    before, now = (_fixed(each) for each in (state.get("config"), config))
    if before != now:
        differing = sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key))
        raise CheckpointError(
            f"run '{run}': {CONFIG} differs from the checkpoint's in {', '.join(differing) or 'everything'}; "
            "put it back, or train anew"
        )
    return state


def _check_cluster(run: Path, config: Mapping[str, Any], changes: Mapping[str, Any]) -> None:
    """Refuses to join a cluster that the run's folder alone names, since it could run any program here."""
    node = config.get("collector")
    address = node.get("address") if isinstance(node, Mapping) else None
    if address is not None and "collector.address" not in changes:
        raise ConfigError(
            f"run '{run}' was driven by a Ray cluster at {shown(address)}; if you trust it, name it again: "
            "collector.address=HOST:PORT; or give collector.address=null for one on this machine"
        )


def _check_is_whole_run(run: Path) -> None:
    """Refuses a folder whose training is kept elsewhere, or nowhere."""
    if (run.parent / STATE).exists():
        raise CheckpointError(
            f"run '{run}' is one of several agents that train side by side; resume them together: resume={run.parent}"
        )
    if (run / SUMMARY).exists() or any(run.glob("checkpoints/*.pt")):  # the folder alone: killed in the first state
        raise CheckpointError(f"run '{run}' was trained by a version of CarRL that kept no {STATE}; train anew")


def _parsed(run: Path, overrides: Sequence[str]) -> dict[str, Any]:
    """The overrides that may change a run, by key."""
    values = {}
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise ConfigError(" ".join(str(error).split())) from error
    for override in parsed:
        key = override.get_key_element()
        if key == "hydra.run.dir" and os.path.realpath(str(override.value())) == os.path.realpath(run):
            continue
        if key not in CHANGEABLE or override.is_sweep_override() or override.is_delete():
            raise ConfigError(
                f"{override.input_line} cannot be given with resume=; a resumed run may change {', '.join(CHANGEABLE)}"
            )
        values[key] = override.value()
    return values


def _fixed(config: Any) -> dict[str, Any]:
    """By key all values that must not change."""
    values = _flat(config, "") if isinstance(config, Mapping) else {}
    return {key: value for key, value in values.items() if key not in CHANGEABLE}


def _flat(node: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key, value in node.items():
        values |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return values
