"""What a run has left of its results, `summary.json` and `metrics.csv`, read back as data that nobody vouches for."""

import csv
import io
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carrl.errors import CheckpointError, shown
from carrl.run.folder import METRICS, SUMMARY, read_text

MOST_EPISODES = 2**20
"""Whose returns are read from one `metrics.csv`."""

Wanted = Mapping[str, tuple[type, ...]]
_COUNT, _NUMBER, _FLAG = (int,), (int, float), (bool,)
_RUN: Wanted = {"episodes": _COUNT, "frames": _COUNT}
_FIRST_LAP: Wanted = {"episode": _COUNT, "frame": _COUNT}
_EVALUATION: Wanted = {
    "lap_completed": _FLAG,
    "progress": _NUMBER,
    "lap_reward": _NUMBER,
    "lap_steps": _COUNT,
    "forward_share": _NUMBER,
    "switches_per_100m": _NUMBER,
    "reversals": _COUNT,
}


def read_summary(run: Path) -> dict[str, Any] | None:
    """What `summary.json` says of a run; None where there is none, as long as the run has not finished.

    Of its figures those that reports show are checked; `first_lap` and `evaluation` may be None.

    Raises:
        CheckpointError: the file is damaged.
    """
    path = run / SUMMARY
    if not os.path.lexists(path):
        return None
    try:
        summary = json.loads(read_text(path), parse_constant=_refuse)
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


def read_returns(run: Path) -> tuple[float, ...]:
    """The return of every ended episode that `metrics.csv` tells of, in order; none where there is no such file.

    Raises:
        CheckpointError: the file is damaged.
    """
    path = run / METRICS
    if not os.path.lexists(path):
        return ()
    returns: list[float] = []
    try:
        for row in csv.DictReader(io.StringIO(read_text(path), newline="")):
            value = float(row["episode_return"])
            if not math.isfinite(value) or len(returns) >= MOST_EPISODES:
                raise ValueError(f"a return of {value}, or more than {MOST_EPISODES} episodes")
            returns.append(value)
    except (ValueError, KeyError, TypeError, csv.Error) as error:  # TypeError: a row that is too short
        raise CheckpointError(f"run '{run}': {METRICS} is damaged: no number in episode_return") from error
    return tuple(returns)


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
