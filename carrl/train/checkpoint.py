"""Checkpoints: tensors and plain values in a file that is read without running code from it.

A run keeps its networks so, and all that moves, so that it can be resumed: the latest state, and the one before it.
"""

import logging
import os
import time
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from carrl.errors import CheckpointError, shown
from carrl.files import read_whole, remove_left_overs, write_whole
from carrl.train.files import CONFIG, EVALUATIONS, METRICS, Inputs

FORMAT_VERSION = 1
MAX_BYTES = 16 * 2**30
"""The largest file that is read; the state of a run has some 100 bytes for each transition in its replay buffer."""
STATE_VERSION = 3
"""Of what a state holds; 2 was that of a trainer for DQN alone, with the trajectories of all validation drives."""
STATE = Path("checkpoints/state.pt")
PREVIOUS = Path("checkpoints/state-previous.pt")
_NEW = Path("checkpoints/.state.partial")  # a left-over if the process is killed before it takes its place
_logger = logging.getLogger(__name__)


def save_checkpoint(path: Path, state: Mapping[str, Any], *, durably: bool = False) -> None:
    """Writes tensors and plain values, whole or not at all.

    Args:
        path: of the file; its folder is made.
        state: of tensors, numbers, strings, None, and dicts, lists and tuples of such.
        durably: wait until the file is on the disk itself, where it outlives the machine's power.

    Raises:
        CheckpointError: the disk refuses it.
    """
    content = BytesIO()  # not the file itself, whose name torch would put into it
    torch.save({"format_version": FORMAT_VERSION, **_detached(state)}, content)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CheckpointError(f"checkpoint '{path}' cannot be written: {error.strerror}") from error
    write_whole(path, content.getvalue(), CheckpointError, durably=durably)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Reads what `save_checkpoint` wrote, onto the CPU.

    Raises:
        CheckpointError: the file is missing, too large, damaged, holds more than tensors and plain values, or has
            another version.
    """
    if not os.path.lexists(path):
        raise CheckpointError(f"checkpoint '{path}' does not exist; name the folder of a run that has begun to train")
    content = read_whole(path, MAX_BYTES, f"checkpoint '{path}'", CheckpointError)
    try:
        _check_archive(content)
        state = torch.load(BytesIO(content), map_location="cpu", weights_only=True)
    except Exception as error:  # torch.load raises whatever the unpickler meets
        raise CheckpointError(f"checkpoint '{path}' is damaged or no checkpoint of CarRL") from error
    version = state.get("format_version") if isinstance(state, dict) else None
    if type(version) is not int or version != FORMAT_VERSION:
        raise CheckpointError(
            f"checkpoint '{path}' has format version {shown(version)}; this CarRL reads {FORMAT_VERSION}: "
            "use the version that wrote it, or train anew"
        )
    return state


def _check_archive(content: bytes) -> None:
    """Checks every byte, which torch does not, and that the file unpacks to no more than its own size."""
    with zipfile.ZipFile(BytesIO(content)) as archive:
        members = archive.infolist()
        if any(member.compress_type != zipfile.ZIP_STORED for member in members):
            raise ValueError("it is compressed")
        if sum(member.file_size for member in members) > len(content):
            raise ValueError("parts of it overlap")
        damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"'{damaged}' in it has another CRC")


def _detached(value: Any) -> Any:
    """The same with tensors of their own on the CPU: torch would save all of the memory that a tensor is a part of."""
    if isinstance(value, Tensor):
        return value.detach().cpu().clone()
    if isinstance(value, Mapping):
        return {key: _detached(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_detached(item) for item in value)
    return value


class StateFile:
    """A run's state on the disk.

    Args:
        run: the run's folder; that of all replicates together, where several train side by side.
        config: resolved, kept with every state, so that one is never taken for another run's.
        interval: between two states, s of wall time.
        inputs: checksums of what the run learns from, kept with every state, too.
    """

    def __init__(self, run: Path, config: Mapping[str, Any], interval: float, inputs: Inputs | None = None) -> None:
        self.run = run
        self._kept = {"state_version": STATE_VERSION, "config": config, "inputs": dict(inputs or {})}
        self._interval = interval
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
    try:
        _check_outline(state)
    except ValueError as error:
        raise CheckpointError(f"run '{run}': the state does not fit the run's configuration: {error}") from error
    return state


def _check_outline(state: Mapping[str, Any]) -> None:
    """Checks what is read of a state before there is a trainer to compare it with.

    Raises:
        ValueError: something is missing, or of another type.
    """
    folder = {"log": None, "tables": {METRICS: "", EVALUATIONS: ""}}
    parts: dict[str, Any] = {"config": {}, "inputs": {}, "folders": [], "runs": [], "learner": {}, "active": []}
    check_fits({name: state.get(name) for name in parts}, parts)
    for number, own in enumerate(state["folders"]):
        check_fits(own, folder, f"folders[{number}]")
    for number, own in enumerate(state["runs"]):
        run = {"status": {"frames": 0, "updates": 0}, "episode_returns": []}
        check_fits(own, run, f"runs[{number}]", whole=False)
    check_fits(state["learner"], {"updates": 0}, "learner", whole=False)


def check_fits(found: Any, wanted: Any, name: str = "the state", whole: bool = True) -> None:
    """Checks that a nested state has the keys and types of another one.

    Tensors may have other sizes, though not another number of dimensions. Anything may stand where the other one has
    None, and any group or list where it has an empty one: whoever loads it checks it.

    Args:
        found: state of plain values and tensors.
        wanted: what it is to be like.
        name: of the state, for messages.
        whole: whether it may have no keys besides.

    Raises:
        ValueError: it is not.
    """
    if wanted is None:
        return
    kind: Any = Mapping if isinstance(wanted, Mapping) else type(wanted)
    if not isinstance(found, kind):
        raise ValueError(f"{name} is missing or of the wrong type")
    pairs: list[tuple[str, Any, Any]] = []
    if isinstance(wanted, Tensor) and (found.dtype, found.ndim) != (wanted.dtype, wanted.ndim):
        raise ValueError(f"{name} is {found.dtype} with {found.ndim} dimensions")
    if isinstance(wanted, Mapping) and wanted:
        differing = wanted.keys() ^ found.keys() if whole else wanted.keys() - found.keys()
        if differing:
            raise ValueError(f"{name} has not the keys that it should: {shown(sorted(map(str, differing)))}")
        pairs = [(f"{name}.{key}", found[key], own) for key, own in wanted.items()]
    elif isinstance(wanted, list | tuple) and wanted:
        if len(found) != len(wanted):
            raise ValueError(f"{name} has {len(found)} entries instead of {len(wanted)}")
        pairs = [(f"{name}[{number}]", *pair) for number, pair in enumerate(zip(found, wanted, strict=True))]
    for part, own, other in pairs:
        check_fits(own, other, part, whole)


def _intact_state(run: Path) -> dict[str, Any]:
    found = [run / name for name in (STATE, PREVIOUS) if (run / name).exists()]
    if not found:
        raise CheckpointError(f"run '{run}' has no {STATE}, so it cannot be resumed; train anew")
    for path in found[:-1]:
        with suppress(CheckpointError):
            return load_checkpoint(path)
        _logger.warning("'%s' is damaged; the run is resumed from '%s' instead.", path, PREVIOUS)
    return load_checkpoint(found[-1])
