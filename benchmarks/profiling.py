"""Where the time of a training run goes, package by package.

A timer of the process's CPU time interrupts the run every 2 ms. The time since the last interruption then counts for
the package of CarRL or TorchRL whose code is running, or has called what is running, such as torch. So no function is
named here, and none can be missing because it moved.
"""

import json
import runpy
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from types import FrameType

from benchmarks.child import CARRL, BenchError, run_child
from benchmarks.contestants import carrl_overrides

HEADER = ("package", "seconds", "share")
LIBRARIES = ("carrl", "torchrl")
IMPORTS, OTHERS = "imports", "all else"
_EVERY_S = 0.002


def profile_rows(compiled: bool, seeds: int, frames: int) -> list[list[str]]:
    """Trains under the timer and returns a row under `HEADER` for each package, the largest first.

    Raises:
        BenchError: the run failed, or no package of CarRL was seen at work.
    """
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "profile.json"
        overrides = carrl_overrides(compiled, seeds, frames, f"{name}/run")
        run_child(["-m", "benchmarks.profiling", str(file), CARRL[1], *CARRL[2:], *overrides])
        return rows_of(json.loads(file.read_text(encoding="utf-8")))


def rows_of(seconds: dict[str, float]) -> list[list[str]]:
    """The table of the seconds by package.

    Raises:
        BenchError: none of them is CarRL's.
    """
    if not any(package.startswith("carrl.") for package in seconds):
        raise BenchError(f"profile: no code of CarRL was seen at work, only {', '.join(seconds) or 'nothing'}")
    total = sum(seconds.values())
    largest = sorted(seconds.items(), key=lambda item: -item[1])
    return [[package, f"{took:.2f}", f"{took / total:.1%}"] for package, took in largest]


def package_of(frame: FrameType | None) -> str:
    """The package whose code runs, such as carrl.task: that of the innermost frame of one of the `LIBRARIES`."""
    package = OTHERS
    while frame is not None:
        file = frame.f_code.co_filename
        if file.startswith("<frozen importlib"):
            return IMPORTS
        if package == OTHERS:
            words = str(frame.f_globals.get("__name__", "")).split(".")
            if words[0] in LIBRARIES and len(words) > 1:
                package = ".".join(words[:2])
        frame = frame.f_back
    return package


class Timer:
    """Counts CPU time by package while it is entered, in the main thread.

    Attributes:
        seconds: of each package.
    """

    def __init__(self) -> None:
        """Starts with nothing."""
        self.seconds: Counter[str] = Counter()

    def __enter__(self) -> "Timer":
        """Starts the timer."""
        self._last = time.process_time()
        signal.signal(signal.SIGPROF, self._count)
        signal.setitimer(signal.ITIMER_PROF, _EVERY_S, _EVERY_S)
        return self

    def __exit__(self, *_: object) -> None:
        """Stops it."""
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, signal.SIG_IGN)

    def _count(self, _signal: int, frame: FrameType | None) -> None:
        now = time.process_time()
        self.seconds[package_of(frame)] += now - self._last
        self._last = now


def main() -> None:
    """Runs `python -m benchmarks.profiling FILE MODULE ARGUMENT...` under the timer and writes the seconds as JSON."""
    file, module, *arguments = sys.argv[1:]
    sys.argv = [module, *arguments]
    timer = Timer()
    try:
        with timer:
            runpy.run_module(module, run_name="__main__")
    finally:
        Path(file).write_text(json.dumps(timer.seconds), encoding="utf-8")


if __name__ == "__main__":
    main()
