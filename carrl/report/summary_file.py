"""A run's `summary.json`, read back as data that nobody vouches for."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carrl.errors import CheckpointError, shown
from carrl.train.files import SUMMARY, read_text

Wanted = Mapping[str, tuple[type, ...]]
_COUNT, _NUMBER, _FLAG = (int,), (int, float), (bool,)
_RUN: Wanted = {"episodes": _COUNT, "frames": _COUNT, "updates": _COUNT, "wall_time_s": _NUMBER}
_FIRST_LAP: Wanted = {"episode": _COUNT, "frame": _COUNT, "wall_time_s": _NUMBER}
_EVALUATION: Wanted = {
    "lap_completed": _FLAG,
    "progress": _NUMBER,
    "lap_reward": _NUMBER,
    "lap_steps": _COUNT,
    "forward_share": _NUMBER,
    "switches_per_100m": _NUMBER,
    "reversals": _COUNT,
}


def read_summary(run: Path) -> dict[str, Any]:
    """What `summary.json` says of a run.

    Of its figures those that reports show are checked; `first_lap` and `evaluation` may be None.

    Raises:
        CheckpointError: the file is damaged.
    """
    try:
        summary = json.loads(read_text(run / SUMMARY), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"run '{run}': {SUMMARY} is damaged: it is not JSON") from error
    try:
        _check("it", summary, _RUN)
        for name, wanted in (("first_lap", _FIRST_LAP), ("evaluation", _EVALUATION)):
            if name not in summary:
                raise ValueError(f"it lacks {name}")
            if summary[name] is not None:
                _check(name, summary[name], wanted)
    except ValueError as error:
        raise CheckpointError(f"run '{run}': {SUMMARY} is damaged: {error}") from None
    return dict(summary)


def missing_lap(summary: Mapping[str, Any], never: str) -> str:
    """What stands in the place of a run's first lap where it has none.

    "not confirmed" of one that did lap, `never` of one that did not, and "-" of one that learnt from logs, which is
    driven once.
    """
    if "transitions" in summary:
        return "-"
    best = summary["evaluation"]
    return "not confirmed" if best is not None and best["lap_completed"] else never


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _check(name: str, found: object, wanted: Wanted) -> None:
    if not isinstance(found, dict):
        raise ValueError(f"{name} is {shown(found)}")
    for key, kinds in wanted.items():
        value: Any = found.get(key)
        is_kind = isinstance(value, kinds) and isinstance(value, bool) == (kinds == _FLAG)
        if not is_kind or not abs(value) <= 2**53:  # inf fails it
            raise ValueError(f"{name} has {shown(value)} as {key}")
