"""What a run was asked to be: its resolved configuration flat, and the words in which it was asked for."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from carrl.errors import CarrlError
from carrl.report.reading import RunResult
from carrl.train.files import read_yaml

OVERRIDES, HYDRA = Path(".hydra/overrides.yaml"), Path(".hydra/hydra.yaml")
WITHIN_GROUP = ("seed", "trainer.seeds", "resume")
"""What may differ within a group."""


@dataclass(frozen=True)
class Choices:
    """How a run was asked for.

    Attributes:
        values: the resolved configuration but for the seed: `loss.gamma` to "0.95".
        options: the option chosen of each group of `conf/`: `loss` to "double_dqn"; empty where nothing tells.
        typed: the keys of the overrides on the command line, but for the seed.
        job: its number in a multirun.
    """

    values: Mapping[str, str] = field(repr=False)
    options: Mapping[str, str] = field(repr=False)
    typed: tuple[str, ...]
    job: int

    def value_of(self, key: str) -> str:
        """What the run has for a key of the configuration, or for a group of `conf/`; "-" for nothing."""
        return self.options.get(key, self.values.get(key, "-"))


def read_choices(run: RunResult) -> Choices:
    """What the run was asked to be.

    Hydra's own files stand in the folder of the run, or in the one above, where several seeds were trained at once.
    What is missing or damaged there only makes names longer, and is passed over.
    """
    values = {key: value for key, value in flat(run.config).items() if key not in WITHIN_GROUP}
    hydra, overrides = _first(run, HYDRA), _first(run, OVERRIDES)
    options = {key: shown(value) for key, value in _at(hydra, "hydra", "runtime", "choices").items()}
    options = {key: option for key, option in options.items() if "/" not in str(key)}  # Hydra's own
    job = _at(hydra, "hydra", "job").get("num")
    typed = [override_key(each) for each in overrides if isinstance(each, str)] if isinstance(overrides, list) else []
    typed = [key for key in dict.fromkeys(typed) if key and key not in WITHIN_GROUP and not key.startswith("hydra")]
    return Choices(values, options, tuple(typed), job if isinstance(job, int) else 0)


def override_key(override: str) -> str:
    """The key of an override: `loss` of `loss=cql`, `+a.b` is `a.b`."""
    return override.partition("=")[0].lstrip("+~").partition("@")[0]


def flat(config: Any, above: str = "") -> dict[str, str]:
    """A nested configuration as dotted keys to values as they are typed."""
    if not isinstance(config, dict) or not config:
        return {above: shown(config)} if above else {}
    leaves: dict[str, str] = {}
    for key, value in config.items():
        leaves |= flat(value, f"{above}.{key}" if above else str(key))
    return leaves


def shown(value: Any) -> str:
    """A value as it is typed: true, null, 0.5, [16,16,8], paper."""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"), default=str)


def _first(run: RunResult, path: Path) -> Any:
    """What the file holds that stands in the run's folder, or else in the one above; None if in neither."""
    found = (_read(folder / path) for folder in (run.folder, run.folder.parent))
    return next((each for each in found if each), None)


def _read(path: Path) -> Any:
    try:
        return read_yaml(path) if path.exists() else None
    except CarrlError:
        return None


def _at(tree: Any, *keys: str) -> dict[str, Any]:
    """The mapping at these keys; empty where there is none."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree if isinstance(tree, dict) else {}
