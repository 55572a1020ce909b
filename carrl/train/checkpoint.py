"""Checkpoints: tensors and plain values in a file that is read without running code from it."""

import os
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from carrl.errors import CheckpointError, shown
from carrl.files import read_whole, write_whole

FORMAT_VERSION = 1
MAX_BYTES = 16 * 2**30
"""The largest file that is read; the state of a run has some 100 bytes for each transition in its replay buffer."""


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
