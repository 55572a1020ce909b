"""Where a run keeps all that moves, so that it can be resumed: the latest state, and the one before it."""

import logging
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from carrl.errors import CheckpointError, shown
from carrl.files import remove_left_overs
from carrl.train.checkpoint import load_checkpoint, save_checkpoint
from carrl.train.files import CONFIG
from carrl.train.inputs import Inputs
from carrl.train.settings import put_back, read_settings

STATE_VERSION = 2
"""Of what a state holds; 1 had no checksums of tracks and logs, no tables and no word on how updates were made."""
STATE = Path("checkpoints/state.pt")
PREVIOUS = Path("checkpoints/state-previous.pt")
_NEW = Path("checkpoints/.state.partial")  # a left-over if the process is killed before it takes its place
_logger = logging.getLogger(__name__)


class StateFile:
    """A run's state on the disk.

    Args:
        run: the run's folder; that of all agents together, where several train side by side.
        config: resolved, kept with every state, so that one is never taken for another run's.
        interval: between two states, s of wall time.
        inputs: checksums of what the run learns from, kept with every state, too.
    """

    def __init__(self, run: Path, config: Mapping[str, Any], interval: float, inputs: Inputs | None = None) -> None:
        self.run = run
        self._kept = {"state_version": STATE_VERSION, "config": config, "inputs": dict(inputs or {})}
        self._interval = interval
        self._settings = read_settings(run)
        self._saved_at = time.monotonic()
        remove_left_overs((run / STATE).parent, (run / CONFIG).parent)

    @property
    def is_due(self) -> bool:
        """Whether the latest state has grown old."""
        return time.monotonic() - self._saved_at >= self._interval

    def save(self, state: Mapping[str, Any]) -> None:
        """Writes a state, whole or not at all; the latest one becomes the one before.

        Raises:
            CheckpointError: the disk refuses it.
        """
        save_checkpoint(self.run / _NEW, {**self._kept, **state}, durably=True)
        try:
            with suppress(FileNotFoundError):
                os.replace(self.run / STATE, self.run / PREVIOUS)
            os.replace(self.run / _NEW, self.run / STATE)
        except OSError as error:
            raise CheckpointError(f"checkpoint '{self.run / STATE}' cannot be written: {error.strerror}") from error
        self._saved_at = time.monotonic()

    def make_room(self) -> None:
        """Removes the state before the latest: a full disk has better use for its bytes."""
        with suppress(OSError):
            if (self.run / STATE).exists():
                (self.run / PREVIOUS).unlink()

    def put_back(self, state: Mapping[str, Any]) -> None:
        """Makes the folder anew after it was deleted or moved, with a state.

        Raises:
            CarrlError: the disk fails.
        """
        put_back(self._settings)
        self.save(state)


def load_state(run: Path) -> dict[str, Any]:
    """The latest state of a run, or the one before where that is missing or damaged.

    Raises:
        CheckpointError: there is none that is intact, or it is of another version.
    """
    state = _intact_state(run)
    version = state.get("state_version", 1)
    if version != STATE_VERSION:
        raise CheckpointError(
            f"run '{run}': its state has the version {shown(version)}, this CarRL goes on from {STATE_VERSION}; "
            "go on with the version of CarRL that wrote it, or train anew"
        )
    return state


def _intact_state(run: Path) -> dict[str, Any]:
    found = [run / name for name in (STATE, PREVIOUS) if (run / name).exists()]
    if not found:
        raise CheckpointError(f"run '{run}' has no {STATE}, so it cannot be resumed; train anew")
    for path in found[:-1]:
        with suppress(CheckpointError):
            return load_checkpoint(path)
        _logger.warning("'%s' is damaged; the run is resumed from '%s' instead.", path, PREVIOUS)
    return load_checkpoint(found[-1])
