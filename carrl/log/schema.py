"""What a log holds: columns of transitions and two small messages, and the protobuf schemas that follow from them.

A log's columns come from its environment's specs and from its algorithm, and the log describes them itself.

Shape letters: `T` transitions in a message, `O` values of an observation, `S` entries of a state, `K` terms of the
reward.
"""

import json
import re
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from carrl.log.messages import Episode, MetricsFields

FORMAT_VERSION = 3
TRANSITIONS, EPISODES, METRICS = "/transitions", "/episodes", "/metrics"
METADATA_NAME, RECOVERY_NAME = "carrl", "carrl.recovery"
COLUMNS_ENTRY = "columns"
"""The entry of a channel's metadata that describes its columns."""
MAX_COLUMNS, MAX_WIDTH = 1000, 2**20
"""Of a log that is read."""

_WIRES = {"float32": "<f4", "float64": "<f8", "int64": "<i8", "bool": "|b1"}
_NARROW = "<i4"
_PROTOBUF_TYPES = {
    "<f4": FieldDescriptorProto.TYPE_FLOAT,
    "<f8": FieldDescriptorProto.TYPE_DOUBLE,
    "<i4": FieldDescriptorProto.TYPE_SFIXED32,
    "<i8": FieldDescriptorProto.TYPE_SFIXED64,
    "|b1": FieldDescriptorProto.TYPE_BOOL,
}
_NAME = re.compile("[a-z][a-z0-9_]{0,63}")

SMALL_MESSAGES: Mapping[str, type[Episode] | type[MetricsFields]] = {EPISODES: Episode, METRICS: MetricsFields}
"""The fields of what is logged one by one, by topic."""

MESSAGE_NAMES: Mapping[str, str] = {
    TRANSITIONS: "carrl.Transitions",
    EPISODES: "carrl.Episode",
    METRICS: "carrl.Metrics",
}
"""The protobuf message of each topic."""

CHANNELS: Mapping[str, int] = {topic: number for number, topic in enumerate(MESSAGE_NAMES, start=1)}
"""The number of each topic's channel in a log that CarRL writes."""
TOPICS: Mapping[int, str] = {number: topic for topic, number in CHANNELS.items()}

FIRST_COLUMN_FIELD = 4
"""Number of the first column's field; before it come the fields of a whole batch."""

_BATCH_FIELDS = {
    "run": FieldDescriptorProto.TYPE_FIXED64,
    "offset": FieldDescriptorProto.TYPE_UINT64,
    "count": FieldDescriptorProto.TYPE_UINT32,
}
_SMALL_TYPES = {
    int: FieldDescriptorProto.TYPE_INT64,
    float: FieldDescriptorProto.TYPE_DOUBLE,
    str: FieldDescriptorProto.TYPE_STRING,
    typing.Literal: FieldDescriptorProto.TYPE_STRING,
}


@dataclass(frozen=True)
class Column:
    """One value, or one row of values, for each transition.

    Attributes:
        name: its name in the file and in `carrl.log.read_columns`: small letters, digits and underscores.
        key: where TorchRL keeps it in a TensorDict.
        dtype: the type it has in memory, before writing and after loading: float32, float64, int64 or bool.
        shape: the shape of one transition's value: () for a scalar, else (width,).
        meaning: what the values are, with their unit.
        entries: what the values of a row are called; none where they have no names.
        narrow: whether integers are written with 32 bits, in which they must fit.
    """

    name: str
    key: str | tuple[str, ...]
    dtype: str
    shape: tuple[int, ...] = ()
    meaning: str = ""
    entries: tuple[str, ...] = ()
    narrow: bool = False

    @property
    def wire(self) -> str:
        """The little-endian NumPy type of its values in the file."""
        return _NARROW if self.narrow else _WIRES[self.dtype]

    @property
    def width(self) -> int:
        """Values of one transition."""
        return self.shape[0] if self.shape else 1

    def check(self) -> None:
        """Raises ValueError where this is no column that a log may have."""
        if not _NAME.fullmatch(self.name) or self.name in _BATCH_FIELDS:
            raise ValueError(f"a column is called {self.name!r:.80}")
        if self.dtype not in _WIRES or (self.narrow and self.dtype != "int64"):
            raise ValueError(f"column '{self.name}' has type {self.dtype!r:.20}, which no log has")
        if len(self.shape) > 1 or not 0 <= self.width <= MAX_WIDTH:
            raise ValueError(f"column '{self.name}' has shape {list(self.shape)!r:.80}; it must be [] or [width]")
        if self.entries and len(self.entries) != self.width:
            raise ValueError(f"column '{self.name}' is {self.width} wide for {len(self.entries)} names")


_TASK = {
    "observation": ("float32", 1),
    "action": (None, None),
    "reward": ("float32", 1),
    "reward_terms": ("float32", 1),
    "next_observation": ("float32", 1),
    "terminated": ("bool", 1),
    "truncated": ("bool", 1),
    "episode": ("int64", 0),
    "step": ("int64", 0),
    "car": ("int64", 0),
    "track": ("int64", 0),
    "state": ("float32", 1),
    "next_state": ("float32", 1),
    "next_gate": ("int64", 0),
    "gates_passed": ("int64", 0),
    "next_gates_passed": ("int64", 0),
    "time_ns": ("int64", 0),
}
"""Type and number of dimensions of the columns that every log has, whatever its algorithm; an action's are free."""


@dataclass(frozen=True)
class Schema:
    """The columns of a log's transitions, in the order of the file.

    Attributes:
        task: those of the environment, which every log has.
        algorithm: what the algorithm has to say of each transition, such as Q-values.
        version: of the format.
    """

    task: tuple[Column, ...]
    algorithm: tuple[Column, ...] = ()
    version: int = FORMAT_VERSION

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """All of them."""
        return self.task + self.algorithm

    @cached_property
    def by_name(self) -> Mapping[str, Column]:
        """All of them, by their names."""
        return {column.name: column for column in self.columns}

    @property
    def keys(self) -> list[str | tuple[str, ...]]:
        """Where a TensorDict has them: what to keep of transitions that are to be logged."""
        return [column.key for column in self.columns]

    def empty(self) -> dict[str, np.ndarray]:
        """No transitions at all, each column with its type in memory."""
        return {column.name: np.zeros((0, *column.shape), column.dtype) for column in self.columns}

    def as_json(self) -> str:
        """The description that a log has of its columns."""
        described = [
            {
                "name": column.name,
                "dtype": column.dtype,
                "shape": column.shape,
                "bits": 32 if column.narrow else np.dtype(column.wire).itemsize * 8,
                "of": "algorithm" if column in self.algorithm else "task",
                "key": column.key,
                "entries": column.entries,
                "meaning": column.meaning,
            }
            for column in self.columns
        ]
        return json.dumps(described)

    @staticmethod
    def from_json(text: str) -> "Schema":
        """Reads what `as_json` wrote.

        Raises:
            ValueError: it describes no columns that a log may have.
        """
        try:
            described = json.loads(text)
            columns = [(entry["of"], _column(entry)) for entry in described]
        except (ValueError, TypeError, KeyError, RecursionError, AttributeError) as error:
            raise ValueError("its columns are not described") from error
        task = tuple(column for of, column in columns if of != "algorithm")
        return Schema(task, tuple(column for of, column in columns if of == "algorithm")).checked()

    def checked(self) -> "Schema":
        """The schema itself.

        Raises:
            ValueError: a column is none, there twice or missing.
        """
        if len(self.by_name) < len(self.columns) or len(self.columns) > MAX_COLUMNS:
            raise ValueError(f"its {len(self.columns)} columns have {len(self.by_name)} names")
        for column in self.columns:
            column.check()
        for name, (dtype, dimensions) in _TASK.items():
            found = self.by_name.get(name)
            if found is None or found not in self.task:
                raise ValueError(f"it has no column '{name}', which every log has")
            if dtype is not None and (found.dtype, len(found.shape)) != (dtype, dimensions):
                raise ValueError(f"column '{name}' has type {found.dtype} {list(found.shape)}")
        for before, after in (("observation", "next_observation"), ("state", "next_state")):
            if self.by_name[before].shape != self.by_name[after].shape:
                raise ValueError(f"columns '{before}' and '{after}' have different widths")
        return self

    @cached_property
    def message_class(self) -> type[Any]:
        """The message class that this code fills and parses.

        It has `bytes` where the file's schema says packed repeated numbers. Both have the same bytes on the wire
        (length, then little-endian values), so a column is one `tobytes()` or one `frombuffer` instead of a Python
        object for each value. `test_a_generic_protobuf_reader_decodes_the_same_numbers` pins it.
        """
        return _message_class(TRANSITIONS, self.fields(wire_twin=True))

    def fields(self, *, wire_twin: bool = False) -> list[FieldDescriptorProto]:
        """The fields of a message, as the file's schema has them, or with `bytes` for every column."""
        fields = [_field(number, name, kind) for number, (name, kind) in enumerate(_BATCH_FIELDS.items(), start=1)]
        for number, column in enumerate(self.columns, start=FIRST_COLUMN_FIELD):
            if wire_twin:
                fields.append(_field(number, column.name, FieldDescriptorProto.TYPE_BYTES))
            else:
                fields.append(_field(number, column.name, _PROTOBUF_TYPES[column.wire], repeated=True))
        return fields


def bare_schema() -> Schema:
    """The columns that every log has, with the least widths: of a log whose own are lost."""
    return Schema(
        tuple(
            Column(name, name, dtype or "int64", (1,) if dimensions else ())
            for name, (dtype, dimensions) in _TASK.items()
        )
    )


def _column(entry: Mapping[str, Any]) -> Column:
    key, shape = entry["key"], tuple(entry["shape"])
    texts = [
        entry["name"],
        entry["dtype"],
        entry["meaning"],
        *entry["entries"],
        *([key] if isinstance(key, str) else key),
    ]
    if not all(isinstance(text, str) for text in texts) or not key or not all(type(size) is int for size in shape):
        raise ValueError("no column")
    narrow = entry["dtype"] == "int64" and entry["bits"] == 32
    key = key if isinstance(key, str) else tuple(key)
    return Column(entry["name"], key, entry["dtype"], shape, entry["meaning"], tuple(entry["entries"]), narrow)


def schema_bytes(topic: str, schema: Schema) -> bytes:
    """The FileDescriptorSet that goes into the file, so that any protobuf reader can decode the topic's messages."""
    fields = schema.fields() if topic == TRANSITIONS else _small_fields(SMALL_MESSAGES[topic])
    descriptors = FileDescriptorSet(file=[_file_descriptor(topic, fields)])
    return bytes(descriptors.SerializeToString(deterministic=True))


@cache
def small_message_class(topic: str) -> type[Any]:
    """The message class of ended episodes or of metrics."""
    return _message_class(topic, _small_fields(SMALL_MESSAGES[topic]))


def _message_class(topic: str, fields: list[FieldDescriptorProto]) -> type[Any]:
    pool = DescriptorPool()
    pool.Add(_file_descriptor(topic, fields))
    found: type[Any] = GetMessageClass(pool.FindMessageTypeByName(MESSAGE_NAMES[topic]))
    return found


def _file_descriptor(topic: str, fields: list[FieldDescriptorProto]) -> FileDescriptorProto:
    package, name = MESSAGE_NAMES[topic].split(".")
    message = DescriptorProto(name=name, field=fields)
    return FileDescriptorProto(name=f"carrl{topic}.proto", package=package, syntax="proto3", message_type=[message])


def _small_fields(small: type[Episode] | type[MetricsFields]) -> list[FieldDescriptorProto]:
    """One field for each of the tuple, after that of the run."""
    fields = [_field(1, "run", FieldDescriptorProto.TYPE_FIXED64)]
    hints = typing.get_type_hints(small)
    for number, name in enumerate(small._fields, start=2):
        hint = typing.get_origin(hints[name]) or hints[name]
        entry = typing.get_args(hints[name])[0] if hint is tuple else hint
        fields.append(_field(number, name, _SMALL_TYPES[entry], repeated=hint is tuple))
    return fields


def _field(number: int, name: str, kind: FieldDescriptorProto.Type, repeated: bool = False) -> FieldDescriptorProto:
    label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
    field = FieldDescriptorProto(number=number, name=name, type=kind, label=label)
    if repeated and kind != FieldDescriptorProto.TYPE_STRING:
        field.options.packed = True
    return field
