"""How far a run that was stopped has come, as its state and its configuration tell."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Progress:
    """What every agent of a run has done, and its limits, each of which ends it.

    Attributes:
        done: by the key of each limit, for one agent after the other.
        limits: by key, such as `trainer.frames`.
        active: indices of the agents that had not ended.
        learning_rate_is_zero: whether it has fallen to 0 for good.
    """

    done: tuple[Mapping[str, int], ...]
    limits: Mapping[str, int]
    active: tuple[int, ...]
    learning_rate_is_zero: bool

    @property
    def keys(self) -> str:
        """The keys of the limits."""
        return " or ".join(self.limits)

    @property
    def is_over(self) -> bool:
        """Whether every agent has reached one of the limits."""
        return all(map(self._has_reached_a_limit, range(len(self.done))))

    @property
    def goes_on(self) -> bool:
        """Whether the agents that had ended are still at their end."""
        return all(self._has_reached_a_limit(index) for index in range(len(self.done)) if index not in self.active)

    def describe(self) -> str:
        """How far it is, or the first of several agents."""
        others = f" (the first of {len(self.done)} agents)" if len(self.done) > 1 else ""
        words = (f"{self.done[0][key]} {key.split('.')[1]} (limit {limit})" for key, limit in self.limits.items())
        return f"it has {' and '.join(words)}{others}"

    def _has_reached_a_limit(self, index: int) -> bool:
        return any(self.done[index][key] >= limit for key, limit in self.limits.items())


def progress_of(config: Mapping[str, Any], state: Mapping[str, Any]) -> Progress | None:
    """How far the run is; None where configuration or state are not what training writes, as is found out later."""
    try:
        updates = state["learner"]["updates"]
        if config.get("data"):
            done = [{"data.updates": updates}]
        else:
            done = [
                {"trainer.frames": run["moment"]["frames"], "trainer.episodes": len(run["episode_returns"])}
                for run in state["runs"]
            ]
        active = tuple(state.get("active", range(len(done))))
        limits = {key: config[key.split(".")[0]][key.split(".")[1]] for key in done[0]}
        decay = config.get("learning_rate") or {"final_share": 1.0}
        is_zero = decay["final_share"] == 0 and updates >= decay["updates"]
    except (KeyError, TypeError, AttributeError, IndexError):
        return None
    numbers = [*limits.values(), *(number for each in done for number in each.values())]
    return Progress(tuple(done), limits, active, is_zero) if all(type(number) is int for number in numbers) else None
