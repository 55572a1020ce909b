"""One episode as an MCAP log for robotics viewers, Foxglove and Lichtblick, which draw and plot it without being told.

A message's time is simulated time since the start of the run, as in the run's own log. What a step of that log holds
has the time at which the step begins; poses and rays are also there after the last step. The track and the driven line
come once, at the beginning. Shapes: `T` steps, `M` other cars, `R` rays, `N` lines.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.log.scene import Floats, Scene
from carrl.log.trace import EpisodeTrace
from carrl.render.colours import DARK, rgb
from carrl.render.episode import EpisodeScene

try:
    import foxglove.messages as fg
    from foxglove import Schema
except ImportError as error:
    raise CarrlError(
        "logs for viewers need foxglove-sdk, which is not installed; pip install 'carrl[export]'"
    ) from error

WORLD_FRAME, CAR_FRAME, OTHER_FRAME = "world", "car", "other_car_"
"""The frames: metres with y to the left of x; and the cars', x ahead. The other cars are counted from 1."""
MOST_NS = 2**32 * 10**9
"""Before which a time of Foxglove's lies, whose seconds have 32 bits."""
PACKAGE = "carrl"
"""Of the messages that are made up here."""
LEVELS = {"info": fg.LogLevel.Info, "warning": fg.LogLevel.Warning, "error": fg.LogLevel.Error}


def write_viewer_log(path: str | Path, trace: EpisodeTrace, title: str) -> None:
    """Writes an .mcap file with Foxglove's schemas, whole or not at all; the same episode gives the same bytes.

    Args:
        path: where to write it; the folder must exist.
        trace: the episode.
        title: what it is, in a line; an entry of the file's metadata.

    Raises:
        CarrlError: it cannot be written there, or is at a time that Foxglove cannot tell.
    """
    scene, content = EpisodeScene(trace), BytesIO()
    writer = Writer(content, compression=CompressionType.ZSTD)
    writer.start(library="carrl")
    facts = {name: f"{value:g}" if isinstance(value, float) else str(value) for name, value in scene.facts.items()}
    writer.add_metadata("episode", {"title": title, **facts})
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    messages = [*_drawings(scene), *_plots(scene)]
    for message in sorted(messages, key=lambda message: message.time_ns):
        schema = message.schema
        if schema.name not in schemas:
            schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if message.topic not in channels:
            channels[message.topic] = writer.register_channel(message.topic, "protobuf", schemas[schema.name])
        writer.add_message(channels[message.topic], message.time_ns, message.content, message.time_ns)
    writer.finish()
    write_whole(path, content.getvalue())


def identifiers(names: Sequence[str]) -> list[str]:
    """Names that protobuf allows, each another, as near to these as can be."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^0-9A-Za-z]+", "_", name).strip("_")
        plain = re.sub(r"^(\d+)_(.+)$", r"\2_\1", plain)  # right_90 of 90° right
        plain = plain if plain[:1].isalpha() else f"_{plain}"
        found.append(f"{plain}_{len(found)}" if plain in found else plain)
    return found


class _FoxgloveMessage(Protocol):
    """A message of one of Foxglove's schemas."""

    def encode(self) -> bytes: ...

    @staticmethod
    def get_schema() -> Schema: ...


@dataclass(frozen=True)
class _Message:
    """A message in protobuf, what its content means, its topic, and its simulated time since the run's start, ns."""

    time_ns: int
    topic: str
    schema: Schema
    content: bytes

    @staticmethod
    def of(time_ns: int, topic: str, message: _FoxgloveMessage) -> "_Message":
        return _Message(time_ns, topic, message.get_schema(), message.encode())


class _Fields:
    """A kind of message that is made up: a field for each number, and one for each state that shows its name.

    Args:
        name: what the message is called.
        numbers: what its fields are called.
        states: for each further field, the names of its states 0, 1, 2 ...
    """

    def __init__(self, name: str, numbers: Sequence[str] = (), **states: Sequence[str]) -> None:
        file = FileDescriptorProto(name=f"{PACKAGE}/{name}.proto", package=PACKAGE, syntax="proto3")
        message = file.message_type.add(name=name)
        for number in identifiers(numbers):
            _add_field(message, number).type = FieldDescriptorProto.TYPE_DOUBLE
        for field, names in states.items():
            kind = message.enum_type.add(name=field.capitalize())
            for index, state in enumerate(identifiers(names)):
                kind.value.add(name=state, number=index)
            added = _add_field(message, field)
            added.type, added.type_name = FieldDescriptorProto.TYPE_ENUM, f".{PACKAGE}.{name}.{kind.name}"
        self._fields = [field.name for field in message.field]
        pool = DescriptorPool()
        pool.AddSerializedFile(file.SerializeToString())
        self._class = GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.{name}"))
        descriptors = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
        self._schema = Schema(name=f"{PACKAGE}.{name}", encoding="protobuf", data=descriptors)

    def message(self, time_ns: int, topic: str, values: Sequence[float]) -> _Message:
        """A message with these values, in the order of the fields."""
        content = self._class(**dict(zip(self._fields, values, strict=True))).SerializeToString()
        return _Message(time_ns, topic, self._schema, content)


def _add_field(message: DescriptorProto, name: str) -> FieldDescriptorProto:
    return message.field.add(name=name, number=len(message.field) + 1, label=FieldDescriptorProto.LABEL_OPTIONAL)


def _plots(scene: EpisodeScene) -> Iterator[_Message]:
    """What is plotted or listed: series and states with a field for each name, and events in words."""
    times = _times_ns(scene.trace)
    for series in scene.series:
        kind = _Fields("".join(word.capitalize() for word in series.name.split("_")), series.entries)
        for time_ns, row in zip(times, series.values.tolist(), strict=False):
            yield kind.message(time_ns, f"/{series.name}", row)
    states = scene.states
    kind = _Fields("Choice" if scene.controls else "Action", **{each.name: each.names for each in states})
    for time_ns, *values in zip(times, *(each.values.tolist() for each in states), strict=False):
        if values:
            yield kind.message(time_ns, "/choice" if scene.controls else "/action", values)
    for event in scene.events:
        time_ns = times[event.row]
        line = fg.Log(timestamp=_stamp(time_ns), level=LEVELS[event.level], message=event.text, name="carrl")
        yield _Message.of(time_ns, "/events", line)


def _drawings(scene: EpisodeScene) -> Iterator[_Message]:
    """What is drawn: first what stays, then what moves."""
    trace, times = scene.trace, _times_ns(scene.trace)
    track = [_lines(each.ends, [each.colour], each.weight) for each in scene.track]
    yield _Message.of(times[0], "/track", _entity(times[0], WORLD_FRAME, "track", track))
    _, ways, colours = scene.trail
    yield _Message.of(times[0], "/drive", _entity(times[0], WORLD_FRAME, "drive", [_lines(ways, colours, 2.0)]))
    poses = [_pose(*pose) for pose in trace.poses.tolist()]
    driven = fg.PosesInFrame(timestamp=_stamp(times[0]), frame_id=WORLD_FRAME, poses=poses)
    yield _Message.of(times[0], "/drive/poses", driven)
    yield _Message.of(times[0], "/car", _cars(times[0], trace.scene, [CAR_FRAME], DARK.car))
    others = [f"{OTHER_FRAME}{car}" for car in range(1, trace.others.shape[1] + 1)]
    if others:
        yield _Message.of(times[0], "/other_cars", _cars(times[0], trace.scene, others, DARK.other_car))
    for time_ns, places in zip(times, trace.others.tolist(), strict=True):
        for frame, place in zip(others, places, strict=True):
            yield _Message.of(time_ns, "/tf", _transform(time_ns, frame, *place))
    angles = trace.scene.sensor_angles
    ahead = trace.ranges[:, :, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    scans = np.where(scene.hits, trace.ranges, np.inf)  # as is the custom, of a ray that meets nothing
    mount = np.array([trace.scene.sensor_mount, 0.0])
    rays = np.stack([np.broadcast_to(mount, ahead.shape), mount + ahead], axis=2)
    for time_ns, place, scan, ray in zip(times, trace.poses.tolist(), scans.tolist(), rays, strict=True):
        yield _Message.of(time_ns, "/tf", _transform(time_ns, CAR_FRAME, *place))
        in_world = fg.PoseInFrame(timestamp=_stamp(time_ns), frame_id=WORLD_FRAME, pose=_pose(*place))
        yield _Message.of(time_ns, "/car/pose", in_world)
        if not scan:
            continue
        yield _Message.of(time_ns, "/car/scan", _scan(time_ns, scan, trace.scene))
        yield _Message.of(time_ns, "/car/rays", _entity(time_ns, CAR_FRAME, "rays", [_lines(ray, [DARK.ray], 1.5)]))


def _cars(time_ns: int, scene: Scene, frames: Sequence[str], name: str) -> fg.SceneUpdate:
    """For each of these frames a flat disc or box with an arrow ahead, in the colour of this name, which go with it."""
    radius, colour = scene.body_radius, _colour(name)
    length, width = scene.body_size or (2 * radius, 2 * radius)
    size = fg.Vector3(x=length, y=width, z=radius / 2)
    disc = fg.CylinderPrimitive(pose=_pose(), size=size, bottom_scale=1.0, top_scale=1.0, color=colour)
    box = fg.CubePrimitive(pose=_pose(), size=size, color=colour)
    bodies: dict[str, Any] = {"cylinders": [disc]} if scene.body_size is None else {"cubes": [box]}
    arrow = fg.ArrowPrimitive(
        pose=_pose(),
        shaft_length=length / 2 + 2 * radius,
        shaft_diameter=radius / 2,
        head_length=radius,
        head_diameter=radius,
        color=colour,
    )
    stamp = _stamp(time_ns)
    entities = [
        fg.SceneEntity(timestamp=stamp, frame_id=frame, id=frame, frame_locked=True, arrows=[arrow], **bodies)
        for frame in frames
    ]
    return fg.SceneUpdate(entities=entities)


def _transform(time_ns: int, frame: str, x: float, y: float, heading: float) -> fg.FrameTransform:
    """Where a car's frame is in the world."""
    return fg.FrameTransform(
        timestamp=_stamp(time_ns),
        parent_frame_id=WORLD_FRAME,
        child_frame_id=frame,
        translation=fg.Vector3(x=x, y=y),
        rotation=_rotation(heading),
    )


def _scan(time_ns: int, ranges: list[float], scene: Scene) -> fg.LaserScan:
    first, last = scene.sensor_angles[[0, -1]].tolist()
    return fg.LaserScan(
        timestamp=_stamp(time_ns),
        frame_id=CAR_FRAME,
        pose=_pose(scene.sensor_mount),
        start_angle=first,
        end_angle=last,
        ranges=ranges,
    )


def _entity(time_ns: int, frame: str, name: str, lines: list[fg.LinePrimitive]) -> fg.SceneUpdate:
    """A scene of one thing made of lines, in the place of what it was before."""
    entity = fg.SceneEntity(timestamp=_stamp(time_ns), frame_id=frame, id=name, lines=lines)
    return fg.SceneUpdate(entities=[entity])


def _lines(ends: Floats, colours: Sequence[str], width: float) -> fg.LinePrimitive:
    """Lines between each two ends, [N, 2, 2], m, in one colour or each in its own; their width in pixels."""
    points = [fg.Point3(x=x, y=y) for x, y in ends.reshape(-1, 2).tolist()]
    shades = [_colour(colour) for colour in colours]
    paint = {"color": shades[0]} if len(shades) == 1 else {"colors": [shade for shade in shades for _ in range(2)]}
    kind = fg.LinePrimitiveLineType.LineList
    return fg.LinePrimitive(type=kind, thickness=width, scale_invariant=True, points=points, **paint)


def _times_ns(trace: EpisodeTrace) -> list[int]:
    """Simulated time since the start of the run, before each step and after the last, [T + 1], ns.

    Raises:
        CarrlError: Foxglove's times do not reach so far.
    """
    times = np.round(trace.times * 1e9).astype(np.int64)
    if times.min() < 0 or times.max() >= MOST_NS:
        raise CarrlError(
            f"episode {trace.episode} ends at {trace.times[-1]:,.0f} s of simulated time; a log for Foxglove can tell "
            f"times from 0 to {MOST_NS // 10**9:,} s; take another format, such as .html"
        )
    return [int(time) for time in times]


def _stamp(time_ns: int) -> fg.Timestamp:
    return fg.Timestamp(*divmod(time_ns, 1_000_000_000))


def _pose(x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> fg.Pose:
    """A place on the ground, m, and a heading, rad counter-clockwise from +x."""
    return fg.Pose(position=fg.Vector3(x=x, y=y), orientation=_rotation(heading))


def _rotation(heading: float) -> fg.Quaternion:
    return fg.Quaternion(z=math.sin(heading / 2), w=math.cos(heading / 2))


def _colour(name: str) -> fg.Color:
    red, green, blue = (part / 255 for part in rgb(name))
    return fg.Color(r=red, g=green, b=blue, a=1.0)
