"""What runs are compared by.

Smoothness is that of the best greedy drive and counts only where that drive completes the lap: a car that crashes
before the first corner has not switched once. A run without a first lap, or whose first lap is not confirmed, has it
after all others'. Returns and
rewards are on the same scale only where the track and what is paid for are the same.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from carrl.report.runs import RunResult

Value = Callable[[RunResult], float | None]


@dataclass(frozen=True)
class Measure:
    """A figure of a run.

    Attributes:
        key: its name in tables for machines, with its unit.
        name: its name for readers.
        more_is_better: whether a larger value is.
        better: what the better of two groups does: "laps after fewer frames".
        form: how a value is written.
        value: of a run that has finished; None where it has none, infinite where it never came.
        limit: what a run counts with in means where its value is infinite: as far as it went.
        scale: parts of the configuration on which its scale depends.
        by_the_clock: whether it is a time, which seeds trained at once share: for them it is one sample, not many.
    """

    key: str
    name: str
    more_is_better: bool
    better: str
    form: str
    value: Value
    limit: Value = lambda run: None
    scale: tuple[str, ...] = ()
    by_the_clock: bool = False

    def is_on_one_scale(self, runs: Iterable[RunResult]) -> bool:
        """Whether the runs' configurations make their values comparable."""
        return len({repr([_part(run.config, key) for key in self.scale]) for run in runs}) < 2

    def write(self, value: float) -> str:
        """A value in words."""
        return "never" if math.isinf(value) else f"{value:{self.form}}"


def _part(config: Any, key: str) -> Any:
    """What the configuration has at a dotted key; None for nothing."""
    for name in key.split("."):
        config = config.get(name) if isinstance(config, dict) else None
    return config


def _summary(run: RunResult) -> dict[str, Any]:
    return run.summary or {}


def _of_first_lap(key: str) -> Value:
    def value(run: RunResult) -> float | None:
        if run.learnt_from_logs:
            return None  # it is driven once, at the end
        first_lap = _summary(run).get("first_lap")
        return math.inf if first_lap is None else float(first_lap[key])

    return value


def _of_best_drive(key: str, of_laps_only: bool = False) -> Value:
    def value(run: RunResult) -> float | None:
        drive = _summary(run).get("evaluation")
        return None if drive is None or (of_laps_only and not drive["lap_completed"]) else float(drive[key])

    return value


def _final_return(run: RunResult) -> float | None:
    return run.ends.mean_returns[-1] if run.ends.mean_returns else None


FIRST_LAP_FRAMES = Measure(
    key="first_lap_frames",
    name="first lap, frames",
    more_is_better=False,
    better="laps after fewer frames",
    form=",.0f",
    value=_of_first_lap("frame"),
    limit=lambda run: float(_summary(run)["frames"]),
)
FIRST_LAP_SECONDS = Measure(
    key="first_lap_s",
    name="first lap, s",
    more_is_better=False,
    better="laps after less time",
    form=",.1f",
    value=_of_first_lap("wall_time_s"),
    limit=lambda run: float(_summary(run)["wall_time_s"]),
    by_the_clock=True,
)
PROGRESS = Measure("progress", "progress", True, "gets farther in its best drive", ".0%", _of_best_drive("progress"))
LAP_REWARD = Measure(
    key="lap_reward",
    name="lap reward",
    more_is_better=True,
    better="has the greater reward in its best drive",
    form=",.0f",
    value=_of_best_drive("lap_reward"),
    scale=(
        "track",
        "reward.collision.weight",
        "reward.proximity.weight",
        "reward.gate.weight",
    ),  # the paper's rewards; turns cost nothing here
)
FINAL_RETURN = Measure(
    key="final_return",
    name="return, last 20 episodes",
    more_is_better=True,
    better="has the greater final return",
    form=",.0f",
    value=_final_return,
    scale=("track", "reward"),
)
SWITCHES = Measure(
    "switches_per_100m",
    "switches / 100 m",
    False,
    "switches less often",
    ".1f",
    _of_best_drive("switches_per_100m", of_laps_only=True),
)
FORWARD_SHARE = Measure(
    "forward_share",
    "forward share",
    True,
    "drives forward more",
    ".1%",
    _of_best_drive("forward_share", of_laps_only=True),
)
MEASURES = (FIRST_LAP_FRAMES, FIRST_LAP_SECONDS, PROGRESS, LAP_REWARD, FINAL_RETURN, SWITCHES, FORWARD_SHARE)
