"""What a log holds: one table of columns, and the protobuf messages that follow from it.

Shape letters: `T` transitions in a message, `R` rays of the distance sensor.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

FORMAT_VERSION = 1
TOPIC = "/transitions"
MESSAGE_NAME = "carrl.Transitions"
METADATA_NAME = "carrl"
TIME_BASE = "log_time and publish_time are simulated nanoseconds since the start of the run"

RAYS = None
"""The width of a column that has one value a ray: free, but one and the same throughout a file."""

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
        shape: the shape of one transition's value: () for a scalar, else (width,).
        meaning: what the values are, with their unit.
    """

    name: str
    key: str | tuple[str, ...]
    wire: str
    dtype: str
    shape: tuple[int | None, ...]
    meaning: str

    @property
    def description(self) -> str:
        """Type, shape and meaning in one line, such as `float32 [3], x m, y m, heading rad`."""
        width = "".join(f" [{'R' if extent is RAYS else extent}]" for extent in self.shape)
        return f"{self.dtype}{width}, {self.meaning}"

    def fits(self, shape: tuple[int, ...]) -> bool:
        """Whether a transition's value may have this shape."""
        wanted = [extent if want is RAYS else want for want, extent in zip(self.shape, shape, strict=False)]
        return len(shape) == len(self.shape) and tuple(wanted) == shape


_POSE = "x m, y m, heading rad counter-clockwise from +x, before the action"
_DISTANCES = "distance to the wall along each ray / sensor range, 0..1"
COLUMNS = (
    Column(
        "observation",
        "observation",
        "<f4",
        "float32",
        (RAYS,),
        f"{_DISTANCES}, before the action; then the last action, if observed",
    ),
    Column("action", "action", "<i4", "int64", (), "0 forward, 1 left, 2 right"),
    Column("reward", ("next", "reward"), "<f4", "float32", (1,), "sum of the reward terms"),
    Column("reward_terms", ("next", "reward_terms"), "<f4", "float32", (4,), "collision, proximity, gate, steering"),
    Column(
        "next_observation",
        ("next", "observation"),
        "<f4",
        "float32",
        (RAYS,),
        f"{_DISTANCES}, after the action; then that action, if observed",
    ),
    Column("terminated", ("next", "terminated"), "|b1", "bool", (1,), "the episode ended here, in a terminal state"),
    Column("truncated", ("next", "truncated"), "|b1", "bool", (1,), "the episode was cut here, in no terminal state"),
    Column("episode", "episode", "<i8", "int64", (), "number of the episode within the run"),
    Column("step", "step", "<i4", "int64", (), "index of the transition within its episode, from 0"),
    Column("env", "env", "<i4", "int64", (), "index of the car among those simulated side by side, from 0"),
    Column("pose", "pose", "<f4", "float32", (3,), _POSE),
    Column("action_value", "action_value", "<f4", "float32", (3,), "Q-values of forward, left, right"),
    Column("epsilon", "epsilon", "<f4", "float32", (), "probability with which an action was drawn at random"),
    Column("exploratory", "exploratory", "|b1", "bool", (), "the action was drawn at random"),
    Column("track", "track", "<i4", "int64", (), "index of the track that the car was on, among the attached ones"),
)


def _file_descriptor(*, wire_twin: bool) -> FileDescriptorProto:
    fields = [
        FieldDescriptorProto(
            name="count", number=1, type=FieldDescriptorProto.TYPE_UINT32, label=FieldDescriptorProto.LABEL_OPTIONAL
        )
    ]
    for number, column in enumerate(COLUMNS, start=2):
        field = FieldDescriptorProto(name=column.name, number=number)
        if wire_twin:
            field.type, field.label = FieldDescriptorProto.TYPE_BYTES, FieldDescriptorProto.LABEL_OPTIONAL
        else:
            field.type, field.label = _PROTOBUF_TYPES[column.wire], FieldDescriptorProto.LABEL_REPEATED
            field.options.packed = True
        fields.append(field)
    package, name = MESSAGE_NAME.split(".")
    message = DescriptorProto(name=name, field=fields)
    return FileDescriptorProto(name="carrl/transitions.proto", package=package, syntax="proto3", message_type=[message])


def schema_bytes() -> bytes:
    """The FileDescriptorSet that goes into the file, so that any protobuf reader can decode the messages."""
    descriptors = FileDescriptorSet(file=[_file_descriptor(wire_twin=False)])
    return bytes(descriptors.SerializeToString(deterministic=True))


@cache
def wire_class() -> type[Any]:
    """The message class that this code fills and parses: `bytes` where the file's schema says packed repeated numbers.

    Both have the same bytes on the wire (length, then little-endian values), so a column is one `tobytes()` or one
    `frombuffer` instead of a Python object for each value. `test_a_generic_protobuf_reader_decodes_the_same_numbers`
    pins it.
    """
    pool = DescriptorPool()
    pool.Add(_file_descriptor(wire_twin=True))
    wire: type[Any] = GetMessageClass(pool.FindMessageTypeByName(MESSAGE_NAME))
    return wire


def empty_columns() -> dict[str, np.ndarray]:
    """No transitions at all, each column with its loaded type; columns of rays have width 0, for nobody wrote it."""
    return {column.name: np.zeros((0, *(extent or 0 for extent in column.shape)), column.dtype) for column in COLUMNS}
