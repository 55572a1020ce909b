"""How long it takes from typing `carrl train experiment=...` to the first greedy lap."""

import csv
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from benchmarks.child import CARRL, ROOT, BenchError, environment, last_line
from benchmarks.figures import spread

RECIPES = ("paper", "fast", "smooth")
CACHES = ("XDG_CACHE_HOME", "TORCHINDUCTOR_CACHE_DIR", "NUMBA_CACHE_DIR")
HEADER = ("recipe", "cache", "first lap after, s", "start-up, s", "env steps", "laps")
_POLL_S = 0.1
_TOLERANCE_S = 1.0


@dataclass(frozen=True)
class FirstLap:
    """When one run first completed a greedy lap that the next evaluation confirmed.

    Attributes:
        after_s: since the process was started.
        start_up_s: of these, until the run's own clock began.
        frame: env steps made by then.
    """

    after_s: float
    start_up_s: float
    frame: int


Laps = dict[str, list[FirstLap | None]]
"""The first laps of every seed, or None where it never lapped, by the state of the caches: cold, warm."""


def time_recipes(seeds: int) -> dict[str, Laps | None]:
    """The first laps of every recipe; None for a recipe that does not exist.

    Every seed is run twice: first with empty caches, in a folder of its own, then with what that left there.

    Raises:
        BenchError: a run failed, or its summary does not say what is needed.
    """
    return {
        recipe: _time_recipe(recipe, seeds) if (ROOT / "conf" / "experiment" / f"{recipe}.yaml").is_file() else None
        for recipe in RECIPES
    }


def _time_recipe(recipe: str, seeds: int) -> Laps:
    laps: Laps = {"cold": [], "warm": []}
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as caches:
            for state, found in laps.items():
                found.append(_time_first_lap(recipe, seed, caches))
                print(f"{recipe}, seed {seed}, {state} cache: {found[-1]}", file=sys.stderr, flush=True)
    return laps


def recipe_row(recipe: str, cache: str, laps: Sequence[FirstLap | None]) -> list[str]:
    """A row under `HEADER`: median and min..max over the seeds that lapped, and how many did."""
    lapped = [lap for lap in laps if lap is not None]
    return [
        recipe,
        cache,
        spread([lap.after_s for lap in lapped]),
        spread([lap.start_up_s for lap in lapped]),
        spread([lap.frame for lap in lapped], digits=0),
        f"{len(lapped)} of {len(laps)}",
    ]


def _time_first_lap(recipe: str, seed: int, caches: str) -> FirstLap | None:
    """Trains until the first greedy lap is confirmed, or to the recipe's end where there is none."""
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, *CARRL, f"experiment={recipe}", f"seed={seed}", f"hydra.run.dir={name}"]
        own_caches = {variable: f"{caches}/{variable}" for variable in CACHES}
        with (Path(name) / "stderr").open("w+", encoding="utf-8") as errors:
            began, seen_s = time.perf_counter(), None
            seen: list[float] = []  # when each evaluation was
            process = subprocess.Popen(
                command, cwd=ROOT, env=environment(own_caches), stdout=subprocess.DEVNULL, stderr=errors
            )
            try:
                while process.poll() is None:
                    laps = _evaluated_laps(Path(name) / "evaluations.csv")
                    seen += [time.perf_counter() - began] * (len(laps) - len(seen))
                    if seen_s is None and (row := confirmed_lap(laps)) is not None:
                        seen_s = seen[row]
                        process.send_signal(signal.SIGTERM)  # upon which a run saves everything and ends
                    time.sleep(_POLL_S)
            finally:
                process.kill()  # does nothing to one that has ended
            errors.seek(0)
            if process.returncode not in (0, 130):
                raise BenchError(f"recipe {recipe}, seed {seed}, failed: {last_line(errors.read())}")
        return read_first_lap(json.loads((Path(name) / "summary.json").read_text(encoding="utf-8")), seen_s)


def read_first_lap(summary: dict, seen_s: float | None) -> FirstLap | None:
    """The first lap in a run's summary; None where there was none.

    Args:
        summary: what `summary.json` holds.
        seen_s: when the lap was seen from outside, s since the start of the process, or None.

    Raises:
        BenchError: the summary does not say when the run's clock began, or contradicts what was seen.
    """
    if summary["first_lap"] is None:
        return None
    if "start_up_s" not in summary:
        raise BenchError("summary.json has no start_up_s, the seconds from the process's start to the trainer's making")
    after_s = summary["start_up_s"] + summary["first_lap"]["wall_time_s"]
    if seen_s is not None and abs(after_s - seen_s) > _TOLERANCE_S:
        raise BenchError(
            f"summary.json says that the first lap came after {after_s:.1f} s, but it was seen at {seen_s:.1f} s"
        )
    return FirstLap(after_s, summary["start_up_s"], summary["first_lap"]["frame"])


def confirmed_lap(laps: Sequence[bool]) -> int | None:
    """The first evaluation that completes the lap and is followed by another that does; None where none is."""
    return next((row for row, pair in enumerate(pairwise(laps)) if all(pair)), None)


def _evaluated_laps(evaluations: Path) -> list[bool]:
    """Whether each evaluation so far completed the lap."""
    if not evaluations.is_file():
        return []
    with evaluations.open(encoding="utf-8", newline="") as file:
        return [row["lap_completed"] == "True" for row in csv.DictReader(file)]
