"""Where the time of a training run goes, part by part, as cProfile sees it."""

import pstats
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.child import CARRL, BenchError, run_child
from benchmarks.contestants import carrl_overrides

HEADER = ("part of the training loop", "seconds", "share")


@dataclass(frozen=True)
class Part:
    """A part of the training loop.

    Attributes:
        name: for the table.
        functions: whose time it is, that of all they call included. Each is `end/of/path.py:function`, or, to count
            only the calls that one caller makes, `end/of/path.py:caller > end/of/path.py:function`. None may be called
            by another one of them.
        within: the part whose time includes it; that part's own share is what its inner parts leave.
    """

    name: str
    functions: tuple[str, ...]
    within: str


LOOP = "other"
PARTS = (
    Part(LOOP, ("carrl/train/trainer.py:run",), ""),
    Part("updates: native call", ("carrl/algorithms/common/compiled_update.py:__call__",), "updates: the rest"),
    Part("updates: sampling", ("carrl/data/replay_buffer.py:sample",), "updates: the rest"),
    Part("updates: tracing, loading native code", ("carrl/train/learner.py:_try_to_compile",), "updates: the rest"),
    Part("updates: the rest", ("carrl/train/learner.py:learn",), LOOP),
    Part("environment and simulator", ("carrl/env/track_env.py:_step", "carrl/env/track_env.py:_reset"), "collector"),
    Part(
        "policy",
        ("torchrl/collectors/_single.py:rollout > torch/nn/modules/module.py:_wrapped_call_impl",),
        "collector",
    ),
    Part("collector", ("torchrl/collectors/_single.py:iterator",), LOOP),
    Part("replay extend", ("torchrl/data/replay_buffers/replay_buffers/tensordict.py:extend",), LOOP),
    Part("recorder", ("carrl/train/folder.py:record",), LOOP),
    Part("evaluation drives", ("carrl/train/callbacks.py:_evaluate",), LOOP),
    Part("episode accounting", ("carrl/data/episodes.py:follow", "carrl/train/replicate_run.py:add_episodes"), LOOP),
)
"""Edit this when a function moves; a name that is not in the profile is an error."""

Profile = Mapping[tuple[str, int, str], tuple[int, int, float, float, Mapping[tuple[str, int, str], Any]]]
"""What `pstats.Stats.stats` holds: calls, own and cumulative seconds, and the same for each caller."""


def profile_rows(compiled: bool, seeds: int, frames: int) -> list[list[str]]:
    """Trains under cProfile and returns a row under `HEADER` for each part, the largest first.

    Raises:
        BenchError: the run failed, or a part has no function in the profile.
    """
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "profile"
        overrides = carrl_overrides(compiled, seeds, frames, f"{name}/run")
        run_child(["-m", "cProfile", "-o", str(file), *CARRL, *overrides])
        own = own_seconds(pstats.Stats(str(file)).stats)  # type: ignore[attr-defined]
    total = sum(own.values())
    rows = [[part, f"{seconds:.2f}", f"{seconds / total:.1%}"] for part, seconds in own.items()]
    return sorted(rows, key=lambda row: -own[row[0]])


def own_seconds(profile: Profile, parts: tuple[Part, ...] = PARTS) -> dict[str, float]:
    """The seconds of every part without those of its inner parts.

    Raises:
        BenchError: a function is not in the profile, or inner parts take more than the part that they are in.
    """
    seconds = {part.name: sum(_cumulative(profile, function) for function in part.functions) for part in parts}
    own = dict(seconds)
    for part in parts:
        if part.within:
            own[part.within] -= seconds[part.name]
    for name, left in own.items():
        if left < -0.01 * seconds[name]:
            raise BenchError(f"profile: the parts within '{name}' take {-left:.2f} s more than it; do they overlap?")
    return own


def _cumulative(profile: Profile, function: str) -> float:
    """Seconds of all functions of this name, with what they call."""
    *caller, callee = function.split(" > ")
    matching = [entry for place, entry in profile.items() if _is(place, callee)]
    if caller:
        matching = [edge for *_, callers in matching for place, edge in callers.items() if _is(place, caller[0])]
    if not matching:
        raise BenchError(f"profile: '{function}' was never called; did it move? Mend PARTS in benchmarks/profiling.py")
    return sum(entry[3] for entry in matching)


def _is(place: tuple[str, int, str], function: str) -> bool:
    path, _, name = function.partition(":")
    return place[2] == name and Path(place[0]).as_posix().endswith(f"/{path}")
