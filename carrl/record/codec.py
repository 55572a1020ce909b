"""Columns to one protobuf message and back; every `ValueError` names the column, what was found and what is right."""

import math
from collections.abc import Mapping

import numpy as np
from google.protobuf.message import DecodeError

from carrl.record.schema import COLUMNS, Column, wire_class

MAX_MESSAGE_BYTES = 8 * 2**20
"""A larger batch is written as several messages, so that a reader needs little memory for one."""


def encode(columns: Mapping[str, np.ndarray]) -> bytes:
    """Serialises T transitions as one message.

    Args:
        columns: every column of the table as [T] or [T, width], with the table's in-memory types.

    Raises:
        ValueError: an integer does not fit its type in the file.
    """
    count = len(columns[COLUMNS[0].name])
    payloads = {column.name: _to_wire(column, columns[column.name]) for column in COLUMNS}
    return bytes(wire_class()(count=count, **payloads).SerializeToString())


def decode(message: bytes) -> dict[str, np.ndarray]:
    """Reads one message into columns [T] or [T, width] that still have their types in the file and are read-only.

    Nothing is allocated by the message's own `count`; it is only compared with the columns' lengths.

    Raises:
        ValueError: not a message of this schema, or its columns disagree about T or R.
    """
    try:
        wire = wire_class().FromString(message)
    except DecodeError as error:
        raise ValueError("not a carrl.Transitions message") from error
    columns = {column.name: _from_wire(column, getattr(wire, column.name), wire.count) for column in COLUMNS}
    check_rays(columns)
    return columns


def pieces(columns: Mapping[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """Cuts a batch into messages of at most `MAX_MESSAGE_BYTES`; an empty batch into none."""
    count = len(columns[COLUMNS[0].name])
    row_bytes = sum(values.dtype.itemsize * math.prod(values.shape[1:]) for values in columns.values())
    rows = max(1, MAX_MESSAGE_BYTES // row_bytes)
    return [{name: values[i : i + rows] for name, values in columns.items()} for i in range(0, count, rows)]


def check_rays(columns: Mapping[str, np.ndarray]) -> None:
    """Raises a ValueError where the observations before and after the action have different widths."""
    before, after = columns["observation"].shape[1], columns["next_observation"].shape[1]
    if before != after:
        raise ValueError(f"column 'next_observation' has width {after}; expected {before}, as column 'observation'")


def row_shapes(columns: Mapping[str, np.ndarray]) -> dict[str, tuple[int, ...]]:
    """The shape of one transition's value in each column: () or (width,)."""
    return {name: values.shape[1:] for name, values in columns.items()}


def check_row_shapes(columns: Mapping[str, np.ndarray], expected: Mapping[str, tuple[int, ...]]) -> None:
    """Raises a ValueError where a width differs from that of the messages before."""
    for name, shape in row_shapes(columns).items():
        if shape != expected[name]:
            raise ValueError(f"column '{name}' has shape {list(shape)}; the file has {list(expected[name])} so far")


def _to_wire(column: Column, values: np.ndarray) -> bytes:
    stored = values.astype(column.wire, copy=False)
    if stored.dtype.itemsize < values.dtype.itemsize and not np.array_equal(stored, values):
        limits = np.iinfo(column.wire)
        raise ValueError(
            f"column '{column.name}' holds {values.min()}..{values.max()}; it must lie in {limits.min}..{limits.max}"
        )
    return stored.tobytes()


def _from_wire(column: Column, payload: bytes, count: int) -> np.ndarray:
    item_bytes = np.dtype(column.wire).itemsize
    width = column.shape[0] if column.shape else 1
    if width is None:
        width = len(payload) // (count * item_bytes) if count else 0
    if len(payload) != count * width * item_bytes:
        raise ValueError(f"column '{column.name}' has {len(payload)} bytes, which do not fit {count} transitions")
    values = np.frombuffer(payload, column.wire)
    if column.dtype == "bool" and (values.view(np.uint8) > 1).any():
        raise ValueError(f"column '{column.name}' holds a byte that is neither 0 nor 1")
    return values.reshape((count, width) if column.shape else (count,))
