"""One job of a sweep, in whatever process and on whatever machine a launcher chose."""

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from carrl.cli.plain import plain
from carrl.cli.records import write_records
from carrl.cli.sweep_hooks import Beginning
from carrl.cli.text.console import Silence
from carrl.cli.training import train
from carrl.errors import CarrlError
from carrl.train.build import build_world, logs_of
from carrl.train.inputs import check_inputs, checksums
from carrl.train.lock import locked
from carrl.train.resumption import resumed_state
from carrl.train.sweep import JobNote, JobState, SweepFolder, read_summaries
from carrl.train.trainer import Trainer

_LOOKS_EVERY_S = 1.0


def train_job(config: DictConfig) -> None:
    """Trains for one job in whatever process a launcher chose, or goes on where an earlier sweep broke off.

    Raises nothing that a user can mend, since launchers would lose it or end the sweep: the job's note tells.
    """
    hydra = HydraConfig.get()
    path, folder = Path(hydra.runtime.output_dir), SweepFolder(Path(os.path.abspath(hydra.sweep.dir)))
    if folder.is_to_stop:
        return
    if Beginning.folder is None and threading.current_thread() is threading.main_thread():
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
    with locked(path):
        state = resumed_state(path, config)
        summaries = read_summaries(path)
        if state and state["config"] == config and summaries and all(summary["finished"] for summary in summaries):
            check_inputs(path, state["inputs"], checksums(build_world(config).circuits, logs_of(config)))
            return "finished before"
        write_records(path)
        train(config, path, state, _Obedient(folder))
    return "finished"


class _Obedient(Silence):
    """Shows nothing, and ends the training once the sweep is to end."""

    def __init__(self, folder: SweepFolder) -> None:
        self._folder, self._looked_at = folder, time.monotonic()

    def __call__(self, trainer: Trainer) -> None:
        if time.monotonic() >= self._looked_at + _LOOKS_EVERY_S:
            self._looked_at = time.monotonic()
            if self._folder.is_to_stop:
                trainer.stop()
