"""What a log holds: one table of columns and two small messages, and the protobuf schemas that follow from them.

Shape letters: `T` transitions in a message, `O` values of an observation, `A` actions, `K` terms of the reward.
"""

import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from carrl.log.messages import Episode, Metrics

FORMAT_VERSION = 2
TRANSITIONS, EPISODES, METRICS = "/transitions", "/episodes", "/metrics"
METADATA_NAME, RECOVERY_NAME = "carrl", "carrl.recovery"
TIME_BASE = (
    "simulated nanoseconds since the start of the run; a batch's log_time is that of its last transition, "
    "its publish_time that of its first"
)

_PROTOBUF_TYPES = {
    "<f4": FieldDescriptorProto.TYPE_FLOAT,
    "<i4": FieldDescriptorProto.TYPE_SFIXED32,
    "<i8": FieldDescriptorProto.TYPE_SFIXED64,
    "|b1": FieldDescriptorProto.TYPE_BOOL,
}


@dataclass(frozen=True)
class Column:
    """One value, or one row of values, for each transition.

    Attributes:
        name: its name in the file and in `carrl.log.read_columns`.
        key: where TorchRL keeps it in a TensorDict.
        wire: the little-endian NumPy type of its values in the file.
        dtype: the type it has in memory, before writing and after loading.
        shape: the shape of one transition's value: () for a scalar, else (width,); a letter is a width that is free,
            but one and the same throughout a file.
        meaning: what the values are, with their unit.
    """

    name: str
    key: str | tuple[str, ...]
    wire: str
    dtype: str
    shape: tuple[int | str, ...]
    meaning: str

    @property
    def description(self) -> str:
        """Type, shape and meaning in one line, such as `float32 [3], x m, y m, heading rad`."""
        width = "".join(f" [{extent}]" for extent in self.shape)
        return f"{self.dtype}{width}, {self.meaning}"

    def fits(self, shape: tuple[int, ...]) -> bool:
        """Whether a transition's value may have this shape."""
        wanted = [extent if isinstance(want, str) else want for want, extent in zip(self.shape, shape, strict=False)]
        return len(shape) == len(self.shape) and tuple(wanted) == shape


_POSE = "x m, y m, heading rad counter-clockwise from +x, before the action"
_DISTANCES = "distance to the wall along each ray / sensor range, 0..1"
COLUMNS = (
    Column(
        "observation",
        "observation",
        "<f4",
        "float32",
        ("O",),
        f"{_DISTANCES}, before the action; then the last action, if observed",
    ),
    Column("action", "action", "<i4", "int64", (), "0 forward, 1 left, 2 right, unless the run has others"),
    Column("reward", ("next", "reward"), "<f4", "float32", (1,), "sum of the reward terms"),
    Column(
        "reward_terms",
        ("next", "reward_terms"),
        "<f4",
        "float32",
        ("K",),
        "what each term paid, in their order: collision, proximity, gate, steering, unless the run has others",
    ),
    Column(
        "next_observation",
        ("next", "observation"),
        "<f4",
        "float32",
        ("O",),
        f"{_DISTANCES}, after the action; then that action, if observed",
    ),
    Column("terminated", ("next", "terminated"), "|b1", "bool", (1,), "the episode ended here, in a terminal state"),
    Column("truncated", ("next", "truncated"), "|b1", "bool", (1,), "the episode was cut here, in no terminal state"),
    Column("episode", "episode", "<i8", "int64", (), "number of the episode within the run"),
    Column("step", "step", "<i4", "int64", (), "index of the transition within its episode, from 0"),
    Column("env", "env", "<i4", "int64", (), "index of the car among those simulated side by side, from 0"),
    Column("pose", "pose", "<f4", "float32", (3,), _POSE),
    Column("action_value", "action_value", "<f4", "float32", ("A",), "Q-values of the actions, in their order"),
    Column("epsilon", "epsilon", "<f4", "float32", (), "probability with which an action was drawn at random"),
    Column("exploratory", "exploratory", "|b1", "bool", (), "the action was drawn at random"),
    Column("track", "track", "<i4", "int64", (), "index of the track that the car was on, among the attached ones"),
    Column(
        "time_ns", "time_ns", "<i8", "int64", (), "simulated time before the action, since the start of the run, ns"
    ),
)

SMALL_MESSAGES: Mapping[str, type[Episode] | type[Metrics]] = {EPISODES: Episode, METRICS: Metrics}
"""What is logged one by one, by topic."""

MESSAGE_NAMES: Mapping[str, str] = {
    TRANSITIONS: "carrl.Transitions",
    EPISODES: "carrl.Episode",
    METRICS: "carrl.Metrics",
}
"""The protobuf message of each topic."""

CHANNELS: Mapping[str, int] = {topic: number for number, topic in enumerate(MESSAGE_NAMES, start=1)}
"""The number of each topic's channel, the same in every log, so that a chunk alone tells what is in it."""

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
    tuple: FieldDescriptorProto.TYPE_DOUBLE,
    typing.Literal: FieldDescriptorProto.TYPE_STRING,
}


def schema_bytes(topic: str) -> bytes:
    """The FileDescriptorSet that goes into the file, so that any protobuf reader can decode the topic's messages."""
    descriptors = FileDescriptorSet(file=[_file_descriptor(topic, wire_twin=False)])
    return bytes(descriptors.SerializeToString(deterministic=True))


@cache
def message_class(topic: str) -> type[Any]:
    """The message class that this code fills and parses.

    Of transitions it has `bytes` where the file's schema says packed repeated numbers. Both have the same bytes on the
    wire (length, then little-endian values), so a column is one `tobytes()` or one `frombuffer` instead of a Python
    object for each value. `test_a_generic_protobuf_reader_decodes_the_same_numbers` pins it.
    """
    pool = DescriptorPool()
    pool.Add(_file_descriptor(topic, wire_twin=True))
    found: type[Any] = GetMessageClass(pool.FindMessageTypeByName(MESSAGE_NAMES[topic]))
    return found


def empty_columns() -> dict[str, np.ndarray]:
    """No transitions at all, each column with its loaded type; a free width is 0, for nobody wrote it."""
    return {
        column.name: np.zeros((0, *(0 if isinstance(extent, str) else extent for extent in column.shape)), column.dtype)
        for column in COLUMNS
    }


def _file_descriptor(topic: str, *, wire_twin: bool) -> FileDescriptorProto:
    fields = _transition_fields(wire_twin) if topic == TRANSITIONS else _small_fields(SMALL_MESSAGES[topic])
    package, name = MESSAGE_NAMES[topic].split(".")
    message = DescriptorProto(name=name, field=fields)
    return FileDescriptorProto(name=f"carrl{topic}.proto", package=package, syntax="proto3", message_type=[message])


def _transition_fields(wire_twin: bool) -> list[FieldDescriptorProto]:
    fields = [_field(number, name, kind) for number, (name, kind) in enumerate(_BATCH_FIELDS.items(), start=1)]
    for number, column in enumerate(COLUMNS, start=FIRST_COLUMN_FIELD):
        if wire_twin:
            fields.append(_field(number, column.name, FieldDescriptorProto.TYPE_BYTES))
        else:
            fields.append(_field(number, column.name, _PROTOBUF_TYPES[column.wire], repeated=True))
    return fields


def _small_fields(small: type[Episode] | type[Metrics]) -> list[FieldDescriptorProto]:
    """One field for each of the tuple, after that of the run."""
    fields = [_field(1, "run", FieldDescriptorProto.TYPE_FIXED64)]
    hints = typing.get_type_hints(small)
    for number, name in enumerate(small._fields, start=2):
        hint = typing.get_origin(hints[name]) or hints[name]
        fields.append(_field(number, name, _SMALL_TYPES[hint], repeated=hint is tuple))
    return fields


def _field(number: int, name: str, kind: FieldDescriptorProto.Type, repeated: bool = False) -> FieldDescriptorProto:
    label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
    field = FieldDescriptorProto(number=number, name=name, type=kind, label=label)
    if repeated:
        field.options.packed = True
    return field
