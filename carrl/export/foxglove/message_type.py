"""Protobuf messages that are made up while a log is written: a field for each value that viewers can plot."""

import re
from collections.abc import Sequence

from foxglove import Schema
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

PACKAGE = "carrl"


class MessageType:
    """A protobuf message of numbers, which can be given names: the field of a state shows the name of its number.

    Args:
        name: what the message is called.
        numbers: what its fields are called.
        states: for each further field, the names of its states 0, 1, 2 ...
    """

    def __init__(self, name: str, numbers: Sequence[str] = (), **states: Sequence[str]) -> None:
        file = FileDescriptorProto(name=f"{PACKAGE}/{name}.proto", package=PACKAGE, syntax="proto3")
        message = file.message_type.add(name=name)
        for number in numbers:
            _add_field(message, number).type = FieldDescriptorProto.TYPE_DOUBLE
        for field, names in states.items():
            _add_state(message, field, names)
        self._fields = [field.name for field in message.field]
        self._class = _message_class(file, name)
        descriptors = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
        self.schema = Schema(name=f"{PACKAGE}.{name}", encoding="protobuf", data=descriptors)

    def encode(self, *values: float) -> bytes:
        """A message with these values, in the order of the fields."""
        content: bytes = self._class(**dict(zip(self._fields, values, strict=True))).SerializeToString()
        return content


def identifiers(names: Sequence[str]) -> list[str]:
    """Names that protobuf allows, each another, as near to these as can be."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^0-9A-Za-z]+", "_", name).strip("_")
        plain = plain if plain[:1].isalpha() else f"_{plain}"
        found.append(f"{plain}_{len(found)}" if plain in found else plain)
    return found


def _add_field(message: DescriptorProto, name: str) -> FieldDescriptorProto:
    return message.field.add(name=name, number=len(message.field) + 1, label=FieldDescriptorProto.LABEL_OPTIONAL)


def _add_state(message: DescriptorProto, name: str, states: Sequence[str]) -> None:
    kind = message.enum_type.add(name=name.capitalize())
    for number, state in enumerate(identifiers(states)):
        kind.value.add(name=state, number=number)
    field = _add_field(message, name)
    field.type, field.type_name = FieldDescriptorProto.TYPE_ENUM, f".{PACKAGE}.{message.name}.{kind.name}"


def _message_class(file: FileDescriptorProto, name: str) -> type[Message]:
    pool = DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    return GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.{name}"))
