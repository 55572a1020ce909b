"""`carrl train -m`: many runs, one after the other or, through one of Hydra's launchers, at once.

The jobs may be other processes on other machines. What they and this one tell each other goes through the sweep's
folder, which all of them see. Every `carrl train` imports this module, hence nothing at its top waits for torch; a
process that runs jobs imports it before Hydra composes their configurations.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from carrl.cli.process import INTERRUPTED, heeded, let_go_of_closed_terminal
from carrl.errors import CarrlError
from carrl.train.composition import composed, plain
from carrl.train.new_folder import check_is_in_no_run, locked, make_new
from carrl.train.overrides import check_is_read
from carrl.train.sweep import JobNote, JobState, SweepFolder, job_name, read_summaries

if TYPE_CHECKING:
    from carrl.cli.text.many_runs import SweepConsole

FLAGS = ("--multirun", "hydra.mode=MULTIRUN")
_LOOKS_EVERY_S = 1.0
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

OmegaConf.register_new_resolver("carrl.job_name", job_name, replace=True)


class Refusal(BaseException):
    """Carries an error past Hydra, which turns every `Exception` of a callback into a warning and goes on."""

    def __init__(self, error: CarrlError) -> None:
        super().__init__(str(error))
        self.error = error


class SweepStartCallback(Callback):
    """Makes the folder of a run or a sweep ready before Hydra writes to it, a new one where none was named.

    Attributes:
        folder: of the sweep that this process has begun; None in one that only runs jobs.
        lock: on that folder, until it is closed.
    """

    folder: SweepFolder | None = None
    lock = ExitStack()

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the run's folder."""
        with suppress(CarrlError):  # Hydra cannot write there either, and says so
            _choose_folder("run", config)

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the sweep's folder and lets nobody else begin a sweep in it."""
        try:
            _choose_folder("sweep", config)
            folder = SweepFolder(Path(os.path.abspath(config.hydra.sweep.dir)))
            check_is_in_no_run(folder.path)
            SweepStartCallback.lock.enter_context(locked(folder.path))
            folder.begin()
        except CarrlError as error:
            raise Refusal(error) from error
        SweepStartCallback.folder = folder


def _choose_folder(kind: str, config: DictConfig) -> None:
    """Makes a new folder by the configured name or one like it, unless it was named in the command."""
    key, given = f"hydra.{kind}.dir", config.hydra.overrides.hydra
    typed: Any = OmegaConf.to_container(given, resolve=False)  # one may be ${hydra.job.num}, which only jobs have
    if any(str(override).lstrip("+").startswith(f"{key}=") for override in typed):
        return
    folder = str(make_new(Path(config.hydra[kind].dir)))
    with read_write(config), open_dict(config):
        config.hydra[kind].dir = folder
        given.append(f"{key}={folder}")  # from which the configurations of a sweep's jobs are made


def sweep(overrides: Sequence[str], run_hydra: Callable[[Sequence[str], Callable[[DictConfig], None]], None]) -> int:
    """Runs all jobs and shows how they go; those that fail do not keep the others from running.

    Args:
        overrides: as typed, with Hydra's flags.
        run_hydra: runs Hydra on overrides, with what to do for each job.

    Raises:
        CarrlError: a job failed, or the overrides are wrong.
        KeyboardInterrupt: a signal ended the sweep, with everything saved.
    """
    from carrl.cli.text.many_runs import SweepConsole  # brings rich, which a single run needs only once it trains

    SweepStartCallback.folder, SweepStartCallback.lock = None, ExitStack()
    for name in _THREADS:  # of the processes that run jobs, one core for each
        os.environ.setdefault(name, "1")
    jobs = _plan(overrides)
    _check_first(jobs, overrides)
    console = SweepConsole(len(jobs))
    with SweepStartCallback.lock:
        with _stopping_on_signals(), _watching(console):
            try:
                run_hydra([*overrides, *_naming(overrides, jobs)], train_job)
            except Exception:
                if not (
                    SweepStartCallback.folder and SweepStartCallback.folder.is_to_stop
                ):  # else a launcher that lost a job to the signal
                    raise
        return _show_end(console)


def _show_end(console: "SweepConsole") -> int:
    """Tells how the sweep ended, and returns its exit code."""
    folder = SweepStartCallback.folder
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
    check_is_read(_own(overrides), composed([*jobs[0], *deleted], Path(folder) if folder else None))


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
        if SweepStartCallback.folder is None:
            raise KeyboardInterrupt
        if number == signal.SIGHUP:
            let_go_of_closed_terminal()
            if SweepStartCallback.folder.is_to_stop:
                return
        if SweepStartCallback.folder.is_to_stop:
            os._exit(INTERRUPTED)
        SweepStartCallback.folder.stop()

    previous = {number: signal.signal(number, stop) for number in heeded()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def _watching(console: "SweepConsole") -> Iterator[None]:
    """Shows how the jobs stand while they run, in whatever processes."""
    is_over = threading.Event()

    def watch() -> None:
        while not is_over.wait(_LOOKS_EVERY_S):
            if SweepStartCallback.folder is not None:
                console.show(SweepStartCallback.folder)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
        if SweepStartCallback.folder is not None:
            console.show(SweepStartCallback.folder)


def train_job(config: DictConfig) -> None:
    """Trains for one job in whatever process a launcher chose, or goes on where an earlier sweep broke off.

    Raises nothing that a user can mend, since launchers would lose it or end the sweep: the job's note tells.
    """
    hydra = HydraConfig.get()
    path, folder = Path(hydra.runtime.output_dir), SweepFolder(Path(os.path.abspath(hydra.sweep.dir)))
    if folder.is_to_stop:
        return
    if SweepStartCallback.folder is None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the one that began tells the jobs
    number, name, start = hydra.job.num, os.path.relpath(path, folder.path), time.monotonic()
    JobNote(number, name, "running").write(path)

    def note(state: JobState, error: str | None = None) -> None:
        JobNote(number, name, state, round(time.monotonic() - start, 3), error).write(path)

    try:
        state = _train_or_go_on(plain(config, config_folders()), path, folder)
        note(state)
        if state == "interrupted":
            folder.stop()
    except CarrlError as error:
        note("failed", str(error))
    except KeyboardInterrupt:
        note("interrupted")
        folder.stop()
    except Exception as error:
        note("failed", f"{type(error).__name__}: {error}")
        raise


def _train_or_go_on(config: dict[str, Any], path: Path, folder: SweepFolder) -> JobState:
    # here, so that a process that only hands out jobs does not wait for what trains
    from carrl.cli.text.console import RoadWarning, StopOnSignals
    from carrl.train.build import build_world, logs_of
    from carrl.train.callbacks import Callback as TrainingCallback
    from carrl.train.experiment import Experiment
    from carrl.train.files import check_inputs, checksums
    from carrl.train.resumption import resumed_state

    class StopFileWatcher(TrainingCallback):
        """Ends the training once the sweep is to end."""

        looked_at = time.monotonic()

        def on_round(self, trainer: Any) -> None:
            """Looks for the file, but not too often."""
            if time.monotonic() >= self.looked_at + _LOOKS_EVERY_S:
                self.looked_at = time.monotonic()
                if folder.is_to_stop:
                    trainer.stop()

    with locked(path):
        state = resumed_state(path, config)
        summaries = read_summaries(path)
        if state and state["config"] == config and summaries and all(summary["finished"] for summary in summaries):
            world = build_world(config)
            check_inputs(path, state["inputs"], checksums(world.circuits, logs_of(config), world.opponents_files))
            return "finished before"
        watcher = StopFileWatcher()
        summaries = Experiment(config, path, hydra_records()).go_on(state, [watcher, RoadWarning(), StopOnSignals()])
    return "finished" if all(summary["finished"] for summary in summaries) else "interrupted"


def hydra_records() -> dict[str, str]:
    """Hydra's own records of how a run was asked for, by file name; to be called from one of its jobs."""
    hydra = HydraConfig.instance()
    return {"hydra.yaml": OmegaConf.to_yaml(hydra.cfg), "overrides.yaml": OmegaConf.to_yaml(hydra.get().overrides.task)}


def config_folders() -> list[Path]:
    """The folders of the configuration of one of Hydra's jobs, in which parts of one's own may lie."""
    sources = HydraConfig.get().runtime.config_sources
    return [Path(each.path) for each in sources if each.schema == "file" and each.provider not in ("main", "schema")]
