"""Where the time of `TrackEnv` goes, as cProfile sees it: by CarRL's functions and by the libraries that they call."""

import pstats
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from benchmarks.child import run_child
from benchmarks.sim_cells import Course, child_arguments

Profile = Mapping[tuple[str, int, str], tuple[int, int, float, float, Mapping[tuple[str, int, str], Any]]]
"""What `pstats.Stats.stats` holds: calls, own and cumulative seconds, and the same for each caller."""

HEADER = ("TrackEnv: own time of", "share")
LEAST_SHARE = 0.01
"""What takes less is shown in one row, `OTHER`."""
OTHER = "other"
LIBRARIES = {
    "tensordict": "TensorDict",
    "torchrl": "TorchRL",
    "torch": "torch's Python",
    "benchmarks": "this benchmark",
}
_NATIVE = "~"  # in the place of a native function's file


def profile_env(track: str, cars: int, seconds: float) -> tuple[list[list[str]], float]:
    """Drives under cProfile; returns a row under `HEADER` for each place, and the share of resets in the whole.

    Raises:
        BenchError: the drive failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "profile"
        run_child([*child_arguments("env", Course([track], [cars], seconds)), "--profile", str(file)])
        profile: Profile = pstats.Stats(str(file)).stats  # type: ignore[attr-defined]
    return share_rows(own_shares(profile)), reset_share(profile)


def own_shares(profile: Profile) -> dict[str, float]:
    """Share of every place; native functions count for the place that calls them."""
    seconds: dict[str, float] = defaultdict(float)
    for function, (_, _, own, _, callers) in profile.items():
        if function[0] != _NATIVE or not callers:
            seconds[place_of(function)] += own
            continue
        for caller, edge in callers.items():
            seconds[place_of(caller)] += edge[2]
    total = sum(seconds.values())
    return {place: own / total for place, own in seconds.items()}


def reset_share(profile: Profile) -> float:
    """Share of the outermost function that resets and does not step, with all that it calls."""
    total = sum(own for _, _, own, *_ in profile.values())
    resetting = [entry[3] for (*_, name), entry in profile.items() if "reset" in name and "step" not in name]
    return max(resetting, default=0.0) / total


def share_rows(shares: Mapping[str, float]) -> list[list[str]]:
    """A row under `HEADER` for each place, the largest first, and one for the small ones."""
    large = {place: share for place, share in shares.items() if share >= LEAST_SHARE and place != OTHER}
    rows = [[place, f"{share:.1%}"] for place, share in sorted(large.items(), key=lambda pair: -pair[1])]
    return [*rows, [OTHER, f"{1 - sum(large.values()):.1%}"]]


def place_of(function: tuple[str, int, str]) -> str:
    """CarRL's function, or the library that it is in."""
    file, _, name = function
    folders = PurePath(file).parts
    for library, title in LIBRARIES.items():
        if library in folders:
            return title
    if "carrl" in folders:
        inside = len(folders) - folders[::-1].index("carrl")
        return f"{'/'.join(folders[inside:])}: {name}"
    return OTHER
