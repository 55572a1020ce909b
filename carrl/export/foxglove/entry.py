"""One message of a viewer log, and the small parts that Foxglove's messages are made of."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from foxglove import Schema
from foxglove.messages import Color, Point3, Pose, Quaternion, Timestamp, Vector3
from numpy.typing import NDArray

from carrl.errors import CarrlError
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.viewer_palette import Colour

WORLD_FRAME, CAR_FRAME = "world", "car"
"""The frames: metres with y to the left of x; and the car's, x ahead."""
MOST_NS = 2**32 * 10**9
"""Before which a time of Foxglove's lies, whose seconds have 32 bits."""


class FoxgloveMessage(Protocol):
    """A message of one of Foxglove's schemas."""

    def encode(self) -> bytes:
        """Its bytes."""

    @staticmethod
    def get_schema() -> Schema:
        """What they mean."""


@dataclass(frozen=True)
class Entry:
    """One message.

    Attributes:
        time_ns: simulated time since the start of the run, ns.
        topic: where it goes.
        schema: what the content means.
        content: protobuf.
    """

    time_ns: int
    topic: str
    schema: Schema
    content: bytes

    @staticmethod
    def of(time_ns: int, topic: str, message: FoxgloveMessage) -> "Entry":
        """A message of one of Foxglove's schemas."""
        return Entry(time_ns, topic, message.get_schema(), message.encode())


def times_ns(trace: EpisodeTrace) -> list[int]:
    """Simulated time since the start of the run, before each step and after the last, [T + 1], ns.

    Raises:
        CarrlError: Foxglove's times do not reach so far.
    """
    times: NDArray[np.int64] = np.round(trace.times * 1e9).astype(np.int64)
    if times.min() < 0 or times.max() >= MOST_NS:
        raise CarrlError(
            f"episode {trace.episode} ends at {trace.times[-1]:,.0f} s of simulated time; a log for Foxglove can tell "
            f"times from 0 to {MOST_NS // 10**9:,} s; take another format, such as .html"
        )
    return times.tolist()


def stamp(time_ns: int) -> Timestamp:
    """A time as Foxglove writes it."""
    return Timestamp(*divmod(time_ns, 1_000_000_000))


def pose(x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> Pose:
    """A place on the ground, m, and a heading, rad counter-clockwise from +x."""
    return Pose(position=Vector3(x=x, y=y), orientation=rotation(heading))


def rotation(heading: float) -> Quaternion:
    """A turn about the upward axis, rad counter-clockwise."""
    return Quaternion(z=math.sin(heading / 2), w=math.cos(heading / 2))


def points(places: Floats) -> list[Point3]:
    """Places on the ground, [..., 2], m, in one row."""
    return [Point3(x=x, y=y) for x, y in places.reshape(-1, 2).tolist()]


def colour(shade: Colour, opacity: float = 1.0) -> Color:
    """A colour as Foxglove writes it, each part 0..1."""
    red, green, blue = (part / 255 for part in shade)
    return Color(r=red, g=green, b=blue, a=opacity)
