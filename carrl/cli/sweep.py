"""`carrl train -m`: many runs, one after the other or, through one of Hydra's launchers, at once.

The jobs may be other processes on other machines. What they and this one tell each other goes through the sweep's
folder, which all of them see.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from hydra.errors import HydraException
from omegaconf import DictConfig

from carrl.cli.overrides import check_is_read, quote
from carrl.cli.plain import composed
from carrl.cli.signals import INTERRUPTED, heeded, let_go_of_closed_terminal
from carrl.cli.sweep_hooks import Beginning
from carrl.cli.text.sweep import SweepConsole
from carrl.errors import CarrlError
from carrl.train.sweep import job_name

FLAGS = ("--multirun", "hydra.mode=MULTIRUN")
_LOOKS_EVERY_S = 1.0
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def sweep(overrides: Sequence[str], run_hydra: Callable[[Sequence[str], Callable[[DictConfig], None]], None]) -> int:
    """Runs all jobs and shows how they go; those that fail do not keep the others from running.

    Args:
        overrides: as typed, with Hydra's flags.
        run_hydra: runs Hydra on overrides, with what to do for each job.

    Raises:
        CarrlError: a job failed, or the overrides are wrong.
        KeyboardInterrupt: a signal ended the sweep, with everything saved.
    """
    Beginning.folder, Beginning.lock = None, ExitStack()
    for name in _THREADS:  # of the processes that run jobs, one core for each
        os.environ.setdefault(name, "1")
    jobs = _plan(overrides)
    _check_first(jobs, overrides)
    console = SweepConsole(len(jobs))
    with Beginning.lock:
        with _stopping_on_signals(), _watching(console):
            try:
                run_hydra([*overrides, *_naming(overrides, jobs)], run_job)
            except Exception:
                if not (
                    Beginning.folder and Beginning.folder.is_to_stop
                ):  # else a launcher that lost a job to the signal
                    raise
        return _show_end(console)


def _show_end(console: SweepConsole) -> int:
    """Tells how the sweep ended, and returns its exit code."""
    folder = Beginning.folder
    if folder is None:  # Hydra only showed help or a configuration
        return 0
    console.print_results(folder)
    failures = [note.error for note in folder.notes().values() if note.state == "failed"]
    if folder.is_to_stop:
        print(f"interrupted; everything is saved: go on with the same command and hydra.sweep.dir={folder.path}")
        raise KeyboardInterrupt
    if failures:
        raise CarrlError("; ".join(dict.fromkeys(map(str, failures))))
    return 0


def run_job(config: DictConfig) -> None:
    """Runs one job; what trains is imported in the process that trains, and not in one that only hands out jobs."""
    from carrl.cli.sweep_job import train_job

    train_job(config)


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


def _check_first(jobs: Sequence[Sequence[str]], overrides: Sequence[str]) -> None:
    """Composes the first job, so that what nothing reads is answered before anything begins.

    Raises:
        ConfigError: its configuration does not compose, or has a key that nothing reads, or one was typed that no job
            reads.
    """
    flags = dict(each.partition("=")[::2] for each in overrides if each.startswith("--"))
    if not jobs or flags.keys() & {"--config-path", "--config-name"}:
        return
    deleted = [each for each in overrides if each.startswith("~") and "=" not in each]
    folder = flags.get("--config-dir")
    searched = [f"hydra.searchpath=[{quote('file://' + os.path.abspath(folder))}]"] if folder else []
    check_is_read(_own(overrides), composed([*jobs[0], *deleted, *searched]))


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
    """Lets the first signal end the sweep once its jobs have saved, and the second this process at once.

    As in a run, a second SIGHUP is passed over.
    """

    def stop(number: int, _frame: object) -> None:
        if Beginning.folder is None:
            raise KeyboardInterrupt
        if number == signal.SIGHUP:
            let_go_of_closed_terminal()
            if Beginning.folder.is_to_stop:
                return
        if Beginning.folder.is_to_stop:
            os._exit(INTERRUPTED)
        Beginning.folder.stop()

    previous = {number: signal.signal(number, stop) for number in heeded()}
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
            if Beginning.folder is not None:
                console.show(Beginning.folder)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
        if Beginning.folder is not None:
            console.show(Beginning.folder)
