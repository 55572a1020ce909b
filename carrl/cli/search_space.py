"""What `carrl tune` searches: the `search` of a configuration, and the overrides that a trial draws from it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from carrl.errors import ConfigError, shown

SEARCH = "search"
"""The key of the configuration; training does not read it."""


@dataclass(frozen=True)
class Range:
    """Numbers from `low` to `high`, both included.

    Attributes:
        log: draw their logarithms evenly, for what matters by factors.
    """

    low: int | float
    high: int | float
    log: bool = False

    def suggest(self, trial: Any, key: str) -> str:
        """The trial's value, as typed; a whole number where both ends are."""
        suggest = trial.suggest_int if isinstance(self.low, int) and isinstance(self.high, int) else trial.suggest_float
        return str(suggest(key, self.low, self.high, log=self.log))


@dataclass(frozen=True)
class Choice:
    """One of these values, as typed: options of a group, numbers, or lists such as [64,32]."""

    values: tuple[str, ...]

    def suggest(self, trial: Any, key: str) -> str:
        """The trial's value."""
        value: str = trial.suggest_categorical(key, self.values)
        return value


SearchSpace = Mapping[str, Range | Choice]


def parse_search_space(node: Any) -> SearchSpace:
    """The search space of a configuration's `search`.

    Raises:
        ConfigError: it is empty, or an entry is neither a range nor a choice.
    """
    if not isinstance(node, Mapping) or not node:
        raise ConfigError(
            f"the configuration has no {SEARCH}; choose one that has, as in carrl tune experiment=tune, "
            f"or write one, as conf/experiment/tune.yaml does"
        )
    return {str(key): _parse(f"{SEARCH}.{key}", entry) for key, entry in node.items()}


def _parse(name: str, entry: Any) -> Range | Choice:
    keys = set(entry) if isinstance(entry, Mapping) else set()
    if keys == {"choices"} and isinstance(entry["choices"], list) and entry["choices"]:
        return Choice(tuple(_typed(value) for value in entry["choices"]))
    if {"low", "high"} <= keys <= {"low", "high", "log"}:
        low, high, log = entry["low"], entry["high"], entry.get("log", False)
        numbers = all(isinstance(end, int | float) and not isinstance(end, bool) for end in (low, high))
        if numbers and isinstance(log, bool) and low < high and not (log and low <= 0):
            return Range(low, high, log)
    raise ConfigError(
        f"{name} is {shown(entry)}; it must be choices: [...] or low: and high:, numbers with low < high, "
        "and, if you like, log: true, for which low must be positive"
    )


def _typed(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
