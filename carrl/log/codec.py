"""What a log holds to protobuf messages and back, and transitions in TorchRL's layout to columns and back.

Every `ValueError` names what was found and what is right. Torch is imported only where it is needed.

Shape letters: `T` transitions in a message.
"""

import typing
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from google.protobuf.message import DecodeError

from carrl.log.messages import Ended, Episode, Metrics, MetricsFields
from carrl.log.schema import EPISODES, METRICS, SMALL_MESSAGES, Column, Schema, small_message_class

if TYPE_CHECKING:
    from tensordict import TensorDict, TensorDictBase

MAX_MESSAGE_BYTES = 8 * 2**20
"""A larger batch is written as several messages, so that a reader needs little memory for one."""

Columns = dict[str, np.ndarray]
"""The columns of a schema by name, each [T] or [T, width]."""

_ENDS = typing.get_args(Ended)
_SMALL_VALUES = {topic: attrgetter(*kind._fields) for topic, kind in SMALL_MESSAGES.items()}


@dataclass(frozen=True)
class Batch:
    """One message of transitions.

    Attributes:
        schema: of its columns.
        run: the run's number, which all of its messages bear.
        offset: how many transitions the file holds before this message.
        columns: T transitions.
    """

    schema: Schema
    run: int
    offset: int
    columns: Columns

    @property
    def count(self) -> int:
        """Transitions, T."""
        return len(self.columns["action"])

    def encode(self) -> bytes:
        """Serialises the batch, whose columns have the schema's in-memory types or those in the file.

        Raises:
            ValueError: an integer does not fit its type in the file.
        """
        payloads = {column.name: _to_wire(column, self.columns[column.name]) for column in self.schema.columns}
        message = self.schema.message_class(run=self.run, offset=self.offset, count=self.count, **payloads)
        return bytes(message.SerializeToString())

    @staticmethod
    def decode(message: bytes, schema: Schema) -> "Batch":
        """Reads one message into columns that still have their types in the file and are read-only.

        Nothing is allocated by the message's own `count`; it is only compared with the columns' lengths.

        Raises:
            ValueError: not a message of this schema, or its columns disagree about T.
        """
        wire = parse_message(schema.message_class, message)
        if wire.count == 0:
            raise ValueError("a batch of no transitions")
        columns = {column.name: _from_wire(column, getattr(wire, column.name), wire.count) for column in schema.columns}
        return Batch(schema, wire.run, wire.offset, columns)


@dataclass(frozen=True)
class Selection:
    """Which transitions to read; everything by default.

    Attributes:
        episodes: numbers of episodes; None for all.
        envs: indices of cars; None for all.
        begin_s: simulated time of the first, s.
        end_s: simulated time before which the last one begins, s.
    """

    episodes: Collection[int] | None = None
    envs: Collection[int] | None = None
    begin_s: float | None = None
    end_s: float | None = None

    @property
    def span_ns(self) -> tuple[float, float]:
        """Begin and end of the time, ns."""
        begin = -np.inf if self.begin_s is None else self.begin_s * 1e9
        return begin, np.inf if self.end_s is None else self.end_s * 1e9

    def of(self, columns: Columns) -> Columns:
        """Those of the columns' transitions that are selected."""
        begin, end = self.span_ns
        times = columns["time_ns"]
        wanted = (times >= begin) & (times < end)
        if self.episodes is not None:
            wanted &= np.isin(columns["episode"], list(self.episodes))
        if self.envs is not None:
            wanted &= np.isin(columns["car"], list(self.envs))
        return columns if wanted.all() else {name: values[wanted] for name, values in columns.items()}


EVERYTHING = Selection()


def encode_small(topic: str, run: int, message: Episode | Metrics) -> bytes:
    """Serialises an ended episode or a message of metrics."""
    fields = MetricsFields.of(message) if isinstance(message, Metrics) else message
    return bytes(small_message_class(topic)(run=run, **fields._asdict()).SerializeToString())


def decode_small(topic: str, message: bytes) -> tuple[int, Episode | Metrics]:
    """Reads what `encode_small` wrote: the run's number and the message.

    Raises:
        ValueError: not a message of this topic's schema.
    """
    wire = parse_message(small_message_class(topic), message)
    values = _SMALL_VALUES[topic](wire)
    if topic == METRICS:
        return wire.run, MetricsFields._make(values).message()
    if wire.ended not in _ENDS or len(wire.end_pose) != 3:
        raise ValueError(f"an episode ended by {wire.ended!r:.20} at {len(wire.end_pose)} coordinates")
    return wire.run, Episode._make(values)._replace(end_pose=tuple(wire.end_pose))


def episode_span(message: bytes) -> tuple[int, int, int]:
    """Number, begin and end, ns, of an encoded episode, in a third of the time that decoding it takes.

    Raises:
        ValueError: not a message of an episode.
    """
    wire = parse_message(small_message_class(EPISODES), message)
    return wire.episode, wire.begin_ns, wire.end_ns


def parse_message(kind: type[typing.Any], message: bytes) -> typing.Any:
    """The message of this class.

    Raises:
        ValueError: it is none.
    """
    try:
        return kind.FromString(message)
    except DecodeError as error:
        raise ValueError(f"not a {kind.DESCRIPTOR.full_name} message") from error


def pieces(columns: Mapping[str, np.ndarray]) -> list[Columns]:
    """Cuts a batch into messages of at most `MAX_MESSAGE_BYTES`; an empty batch into none."""
    count = len(columns["action"])
    row_bytes = sum(values.dtype.itemsize * values[:1].size for values in columns.values())
    rows = max(1, MAX_MESSAGE_BYTES // max(1, row_bytes))
    return [{name: values[i : i + rows] for name, values in columns.items()} for i in range(0, count, rows)]


def columns_of(transitions: "TensorDictBase", schema: Schema) -> Columns:
    """The columns of a batch of transitions [T], on the CPU.

    Raises:
        ValueError: a key is missing, or has another type or shape than in the schema.
    """
    if transitions.batch_dims != 1:
        raise ValueError(f"the batch size is {list(transitions.batch_size)}; flatten it to [T]")
    return {column.name: _values(transitions, column) for column in schema.columns}


def tensordict_of(columns: Mapping[str, np.ndarray], schema: Schema) -> "TensorDict":
    """The transitions [T] in TorchRL's layout, sharing the columns' memory; also ("next", "done") and the poses."""
    import torch
    from tensordict import TensorDict

    transitions = TensorDict({}, batch_size=[len(columns["action"])])
    for column in schema.columns:
        transitions.set(column.key, torch.from_numpy(columns[column.name]))
    transitions["next", "done"] = transitions["next", "terminated"] | transitions["next", "truncated"]
    for name, key in (("state", "pose"), ("next_state", ("next", "pose"))):
        if key not in transitions.keys(include_nested=True):
            transitions.set(key, torch.from_numpy(columns[name])[:, :3])
    return transitions


def _values(transitions: "TensorDictBase", column: Column) -> np.ndarray:
    tensor = transitions.get(column.key, None)
    if tensor is None:
        raise ValueError(f"column '{column.name}': the transitions have no key {column.key!r}; add it")
    dtype, shape = str(tensor.dtype).removeprefix("torch."), tuple(tensor.shape[1:])
    if dtype != column.dtype:
        raise ValueError(f"column '{column.name}' has type {dtype}; expected {column.dtype}")
    if shape != column.shape:
        raise ValueError(
            f"column '{column.name}' has shape {list(shape)} for each transition; expected {list(column.shape)}"
        )
    values: np.ndarray = tensor.detach().cpu().numpy()
    return values


def _to_wire(column: Column, values: np.ndarray) -> bytes:
    stored = values.astype(column.wire, copy=False)
    if stored.dtype.itemsize < values.dtype.itemsize and not np.array_equal(stored, values):
        limits = np.iinfo(column.wire)
        raise ValueError(
            f"column '{column.name}' holds {values.min()}..{values.max()}; it must lie in {limits.min}..{limits.max}"
        )
    return stored.tobytes()


def _from_wire(column: Column, payload: bytes, count: int) -> np.ndarray:
    if len(payload) != count * column.width * np.dtype(column.wire).itemsize:
        raise ValueError(f"column '{column.name}' has {len(payload)} bytes, which do not fit {count} transitions")
    values = np.frombuffer(payload, column.wire)
    if column.dtype == "bool" and (values.view(np.uint8) > 1).any():
        raise ValueError(f"column '{column.name}' holds a byte that is neither 0 nor 1")
    return values.reshape((count, *column.shape))
