"""TorchRL's nested layout of transitions to the log's columns, and back. Imports torch only where it is needed."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from carrl.log.codec import check_rays
from carrl.log.schema import COLUMNS, Column

if TYPE_CHECKING:
    from tensordict import TensorDict, TensorDictBase


def columns_of(transitions: "TensorDictBase") -> dict[str, np.ndarray]:
    """The columns of a batch of transitions [T], on the CPU.

    Raises:
        ValueError: a key is missing, or has another type or shape than in the table of columns.
    """
    if transitions.batch_dims != 1:
        raise ValueError(f"the batch size is {list(transitions.batch_size)}; flatten it to [T]")
    columns = {column.name: _values(transitions, column) for column in COLUMNS}
    check_rays(columns)
    return columns


def tensordict_of(columns: Mapping[str, np.ndarray]) -> "TensorDict":
    """The transitions [T] in TorchRL's layout, sharing the columns' memory; also ("next", "done")."""
    import torch
    from tensordict import TensorDict

    transitions = TensorDict({}, batch_size=[len(columns[COLUMNS[0].name])])
    for column in COLUMNS:
        transitions.set(column.key, torch.from_numpy(columns[column.name]))
    transitions["next", "done"] = transitions["next", "terminated"] | transitions["next", "truncated"]
    return transitions


def _values(transitions: "TensorDictBase", column: Column) -> np.ndarray:
    tensor = transitions.get(column.key, None)
    if tensor is None:
        raise ValueError(f"column '{column.name}': the transitions have no key {column.key!r}; add it")
    dtype = str(tensor.dtype).removeprefix("torch.")
    if dtype != column.dtype:
        raise ValueError(f"column '{column.name}' has type {dtype}; expected {column.dtype}")
    shape = tuple(tensor.shape[1:])
    if not column.fits(shape):
        expected = ", ".join(map(str, column.shape))
        raise ValueError(f"column '{column.name}' has shape {list(shape)} for each transition; expected [{expected}]")
    values: np.ndarray = tensor.detach().cpu().numpy()
    return values
