"""Checkpoints: what a run has learnt, saved so that loading runs no code."""

from io import BytesIO
from pathlib import Path
from typing import Any

import torch

from carrl.errors import CheckpointError
from carrl.files import write_whole

FORMAT_VERSION = 1


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Writes tensors and plain values, whole or not at all.

    Raises:
        CheckpointError: the disk refuses it.
    """
    content = BytesIO()  # not the file itself, whose name torch would put into it
    torch.save({"format_version": FORMAT_VERSION, **state}, content)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CheckpointError(f"checkpoint '{path}' cannot be written: {error.strerror}") from error
    write_whole(path, content.getvalue(), CheckpointError)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Reads what `save_checkpoint` wrote, onto the CPU.

    Raises:
        CheckpointError: the file is missing, damaged, holds more than tensors and plain values, or has another version.
    """
    if not path.is_file():
        raise CheckpointError(f"checkpoint '{path}' does not exist; name the folder of a run that has begun to train")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch.load raises whatever the unpickler meets
        raise CheckpointError(f"checkpoint '{path}' is damaged or no checkpoint of CarRL") from error
    version = state.get("format_version") if isinstance(state, dict) else None
    if version != FORMAT_VERSION:
        raise CheckpointError(f"checkpoint '{path}' has format version {version}; this CarRL reads {FORMAT_VERSION}")
    return state
