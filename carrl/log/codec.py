"""What a log holds to protobuf messages and back; every `ValueError` names what was found and what is right.

Shape letters: `T` transitions in a message.
"""

import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from google.protobuf.message import DecodeError

from carrl.log.messages import Ended, Episode, Metrics
from carrl.log.schema import (
    COLUMNS,
    EPISODES,
    MESSAGE_NAMES,
    METRICS,
    SMALL_MESSAGES,
    TRANSITIONS,
    Column,
    message_class,
)

MAX_MESSAGE_BYTES = 8 * 2**20
"""A larger batch is written as several messages, so that a reader needs little memory for one."""

Columns = dict[str, np.ndarray]
"""The columns of the table by name, each [T] or [T, width]."""

_ENDS = typing.get_args(Ended)
_SMALL_VALUES = {topic: attrgetter(*kind._fields) for topic, kind in SMALL_MESSAGES.items()}


@dataclass(frozen=True)
class Batch:
    """One message of transitions.

    Attributes:
        run: the run's number, which all of its messages bear.
        offset: how many transitions the file holds before this message.
        columns: T transitions.
    """

    run: int
    offset: int
    columns: Columns

    @property
    def count(self) -> int:
        """Transitions, T."""
        return len(self.columns["action"])

    def encode(self) -> bytes:
        """Serialises the batch, whose columns have the table's in-memory types or those in the file.

        Raises:
            ValueError: an integer does not fit its type in the file.
        """
        payloads = {column.name: _to_wire(column, self.columns[column.name]) for column in COLUMNS}
        message = message_class(TRANSITIONS)(run=self.run, offset=self.offset, count=self.count, **payloads)
        return bytes(message.SerializeToString())

    @staticmethod
    def decode(message: bytes) -> "Batch":
        """Reads one message into columns that still have their types in the file and are read-only.

        Nothing is allocated by the message's own `count`; it is only compared with the columns' lengths.

        Raises:
            ValueError: not a message of this schema, or its columns disagree about T or R.
        """
        wire = _parse(TRANSITIONS, message)
        columns = {column.name: _from_wire(column, getattr(wire, column.name), wire.count) for column in COLUMNS}
        if wire.count == 0:
            raise ValueError("a batch of no transitions")
        check_rays(columns)
        return Batch(wire.run, wire.offset, columns)


def encode_small(topic: str, run: int, message: Episode | Metrics) -> bytes:
    """Serialises an ended episode or a message of metrics."""
    return bytes(message_class(topic)(run=run, **message._asdict()).SerializeToString())


def decode_small(topic: str, message: bytes) -> tuple[int, Episode | Metrics]:
    """Reads what `encode_small` wrote: the run's number and the message.

    Raises:
        ValueError: not a message of this topic's schema.
    """
    wire = _parse(topic, message)
    values = _SMALL_VALUES[topic](wire)
    if topic == METRICS:
        return wire.run, Metrics._make(values)
    if wire.ended not in _ENDS or len(wire.end_pose) != 3:
        raise ValueError(f"an episode ended by {wire.ended!r:.20} at {len(wire.end_pose)} coordinates")
    return wire.run, Episode._make(values)._replace(end_pose=tuple(wire.end_pose))


def episode_span(message: bytes) -> tuple[int, int, int]:
    """Number, begin and end, ns, of an encoded episode, in a third of the time that decoding it takes.

    Raises:
        ValueError: not a message of an episode.
    """
    wire = _parse(EPISODES, message)
    return wire.episode, wire.begin_ns, wire.end_ns


def pieces(columns: Mapping[str, np.ndarray]) -> list[Columns]:
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


def _parse(topic: str, message: bytes) -> typing.Any:
    try:
        return message_class(topic).FromString(message)
    except DecodeError as error:
        raise ValueError(f"not a {MESSAGE_NAMES[topic]} message") from error


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
    if isinstance(width, str):
        width = len(payload) // (count * item_bytes) if count else 0
    if len(payload) != count * width * item_bytes:
        raise ValueError(f"column '{column.name}' has {len(payload)} bytes, which do not fit {count} transitions")
    values = np.frombuffer(payload, column.wire)
    if column.dtype == "bool" and (values.view(np.uint8) > 1).any():
        raise ValueError(f"column '{column.name}' holds a byte that is neither 0 nor 1")
    return values.reshape((count, width) if column.shape else (count,))
