"""`carrl train -m`: many runs, one after the other or, through one of Hydra's launchers, at once.

The jobs may be other processes on other machines. What they and this one tell each other goes through the sweep's
folder, which all of them see.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from carrl.cli.plain import plain
from carrl.cli.signals import INTERRUPTED
from carrl.cli.training import train
from carrl.errors import CarrlError
from carrl.run.resumption import resumed_state
from carrl.run.sweep import JobNote, JobState, SweepFolder, job_name, read_summaries
from carrl.run.training import Training
from carrl.view.console import Silence
from carrl.view.sweep import SweepConsole

FLAGS = ("-m", "--multirun", "hydra.mode=MULTIRUN")
_LOOKS_EVERY_S = 1.0
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

# The folder of a job, in conf/train.yaml. Processes that run jobs import this module before they need it.
OmegaConf.register_new_resolver("carrl.job_name", job_name, replace=True)

_began: SweepFolder | None = None
"""The sweep that this process has begun; None in one that only runs jobs."""


class Beginning(Callback):
    """Tells this process where Hydra puts the sweep, before its first job; conf/train.yaml names it."""

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the folder ready."""
        global _began
        _began = SweepFolder(Path(os.path.abspath(config.hydra.sweep.dir)))
        _began.begin()


def sweep(overrides: Sequence[str], run_hydra: Callable[[Sequence[str], Callable[[DictConfig], None]], None]) -> int:
    """Runs all jobs and shows how they go; those that fail do not keep the others from running.

    Args:
        overrides: as typed, with Hydra's flags.
        run_hydra: runs Hydra on overrides, with what to do for each job.

    Raises:
        CarrlError: a job failed, or the overrides are wrong.
        KeyboardInterrupt: a signal ended the sweep, with everything saved.
    """
    global _began
    _began = None
    for name in _THREADS:  # of the processes that run jobs, one core for each
        os.environ.setdefault(name, "1")
    jobs = _plan(overrides)
    console = SweepConsole(len(jobs))
    with _stopping_on_signals(), _watching(console):
        try:
            run_hydra([*overrides, *_naming(overrides, jobs)], run_job)
        except Exception:
            if _began is None or not _began.is_to_stop:  # else a launcher that lost a job to the signal
                raise
    if _began is None:  # Hydra only showed help or a configuration
        return 0
    console.print_results(_began)
    failures = [note.error for note in _began.notes().values() if note.state == "failed"]
    if _began.is_to_stop:
        print(f"interrupted; everything is saved: go on with the same command and hydra.sweep.dir={_began.path}")
        raise KeyboardInterrupt
    if failures:
        raise CarrlError("; ".join(dict.fromkeys(map(str, failures))))
    return 0


def run_job(config: DictConfig) -> None:
    """Trains for one job in whatever process a launcher chose, or goes on where an earlier sweep broke off.

    Raises nothing that a user can mend, since launchers would lose it or end the sweep: the job's note tells.
    """
    hydra = HydraConfig.get()
    path, folder = Path(hydra.runtime.output_dir), SweepFolder(Path(os.path.abspath(hydra.sweep.dir)))
    if folder.is_to_stop:
        return
    if _began is None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the one that began tells the jobs
    number, name, start = hydra.job.num, os.path.relpath(path, folder.path), time.monotonic()
    JobNote(number, name, "running").write(path)

    def note(state: JobState, error: str | None = None) -> None:
        JobNote(number, name, state, round(time.monotonic() - start, 3), error).write(path)

    try:
        note(_train_or_go_on(plain(config), path, folder))
    except CarrlError as error:
        note("failed", str(error))
    except KeyboardInterrupt:
        note("interrupted")
        folder.stop()
    except Exception as error:
        note("failed", f"{type(error).__name__}: {error}")
        raise


def _train_or_go_on(config: dict[str, Any], path: Path, folder: SweepFolder) -> JobState:
    state = resumed_state(path, config)
    summaries = read_summaries(path)
    if state and state["config"] == config and summaries and all(summary["finished"] for summary in summaries):
        return "finished before"
    train(config, path, state, _Obedient(folder))
    return "finished"


class _Obedient(Silence):
    """Shows nothing, and ends the training once the sweep is to end."""

    def __init__(self, folder: SweepFolder) -> None:
        self._folder, self._looked_at = folder, time.monotonic()

    def __call__(self, trainer: Training) -> None:
        if time.monotonic() >= self._looked_at + _LOOKS_EVERY_S:
            self._looked_at = time.monotonic()
            if self._folder.is_to_stop:
                trainer.stop()


def _plan(overrides: Sequence[str]) -> list[list[str]]:
    """The overrides of each job; none where only Hydra can tell."""
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
    from hydra.core.override_parser.overrides_parser import OverridesParser

    try:
        parsed = OverridesParser.create().parse_overrides(_own(overrides))
        jobs: list[list[str]] = BasicSweeper.split_arguments(parsed, None)[0]
    except (HydraException, TypeError, AttributeError, AssertionError):  # wrong ones, of which Hydra tells, or a glob
        return []
    return jobs


def _naming(overrides: Sequence[str], jobs: Sequence[Sequence[str]]) -> list[str]:
    """Overrides that give each job's folder a name of its own, as short as may be."""
    if not jobs or any(override.startswith("hydra.sweep.subdir=") for override in overrides):
        return []
    keys = [override.partition("=")[0] for override in jobs[0]]
    fixed = [key for index, key in enumerate(keys) if len({job[index] for job in jobs}) == 1]
    if len({job_name(job, fixed) for job in jobs}) < len(jobs):
        return ["hydra.sweep.subdir=${hydra.job.num}"]
    return [f"hydra.job.config.override_dirname.exclude_keys=[{','.join(fixed)}]"]


def _own(overrides: Sequence[str]) -> list[str]:
    """Those of the overrides that are not Hydra's."""
    return [each for each in overrides if "=" in each and not each.lstrip("+~").startswith(("hydra.", "hydra/", "-"))]


@contextmanager
def _stopping_on_signals() -> Iterator[None]:
    """Lets the first SIGINT or SIGTERM end the sweep once its jobs have saved, and the second this process at once."""

    def stop(_number: int, _frame: object) -> None:
        if _began is None:
            raise KeyboardInterrupt
        if _began.is_to_stop:
            os._exit(INTERRUPTED)
        _began.stop()

    previous = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def _watching(console: SweepConsole) -> Iterator[None]:
    """Shows how the jobs stand while they run, in whatever processes."""
    is_over = threading.Event()

    def watch() -> None:
        while not is_over.wait(_LOOKS_EVERY_S):
            if _began is not None:
                console.show(_began)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
        if _began is not None:
            console.show(_began)
