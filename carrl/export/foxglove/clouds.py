"""Track, driven line, car and rays once more as coloured points, for viewers that draw no scenes, as Rerun 0.41.

Shapes: `S` lines, `R` rays, `N` points.
"""

from collections.abc import Iterator

import numpy as np
from foxglove.messages import PackedElementField, PackedElementFieldNumericType, PointCloud
from numpy.typing import NDArray

from carrl.export.foxglove.entry import CAR_FRAME, WORLD_FRAME, Entry, pose, stamp, times_ns
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import ray_directions
from carrl.render.viewer_palette import CAR, GATE, RAY, WALL, action_colours

POINT = np.dtype([("place", "<f4", 3), ("colour", "u1", 4)])
_FLOAT, _BYTE = PackedElementFieldNumericType.Float32, PackedElementFieldNumericType.Uint8
FIELDS = [
    *(PackedElementField(name=name, offset=4 * i, type=_FLOAT) for i, name in enumerate("xyz")),
    *(
        PackedElementField(name=name, offset=12 + i, type=_BYTE)
        for i, name in enumerate(("red", "green", "blue", "alpha"))
    ),
]
SPACING = 0.3
"""Between the points of walls and gates, m; more on a long circuit."""
MOST_POINTS = 6000
"""Of the walls of a long circuit, about."""
RAY_POINTS = 16
"""Of each ray."""


def cloud_entries(trace: EpisodeTrace) -> Iterator[Entry]:
    """Yields all messages that are points: first what stays, then the car with its rays."""
    times = times_ns(trace)
    yield Entry.of(times[0], "/track/points", _cloud(times[0], WORLD_FRAME, _track(trace)))
    yield Entry.of(times[0], "/drive/points", _cloud(times[0], WORLD_FRAME, _drive(trace)))
    car = _car(trace)
    rays = np.linspace(0, 1, RAY_POINTS + 1)[1:, None, None] * ray_directions(trace.scene)
    for time_ns, ranges in zip(times, trace.ranges, strict=True):
        seen = _coloured(ranges[:, None] * rays, RAY)
        yield Entry.of(time_ns, "/car/points", _cloud(time_ns, CAR_FRAME, np.concatenate([seen, car])))


def _track(trace: EpisodeTrace) -> NDArray[np.void]:
    walls, gates = trace.track.walls, trace.track.gates
    spacing = max(SPACING, float(_lengths(walls).sum()) / MOST_POINTS)
    return np.concatenate([_coloured(_dotted(walls, spacing), WALL), _coloured(_dotted(gates, spacing), GATE)])


def _drive(trace: EpisodeTrace) -> NDArray[np.void]:
    """A point where each step began, in the colour of its action."""
    palette = np.array(action_colours(len(trace.scene.action_names)), dtype=np.uint8)
    return _coloured(trace.poses[:-1, :2], palette[trace.actions])


def _car(trace: EpisodeTrace) -> NDArray[np.void]:
    """The rim of the car's disc and a stroke ahead, in its own frame."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    nose = np.linspace([0, 0], [3, 0], 12)
    return _coloured(trace.scene.body_radius * np.concatenate([rim, nose]), CAR)


def _lengths(lines: Floats) -> Floats:
    return np.asarray(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1))


def _dotted(lines: Floats, spacing: float) -> Floats:
    """Points along lines [S, 2, 2], m, at most so far apart, [N, 2], m."""
    counts = np.ceil(_lengths(lines) / spacing).astype(np.int64) + 1
    begin, end = np.repeat(lines, counts, axis=0).transpose(1, 0, 2)
    shares = np.concatenate([np.linspace(0, 1, count) for count in counts])
    return np.asarray(begin + shares[:, None] * (end - begin))


def _coloured(places: Floats, colours: NDArray[np.uint8] | tuple[int, int, int]) -> NDArray[np.void]:
    """Points on the ground, [..., 2], m, of one colour, or each of its own, [N, 3]."""
    places = places.reshape(-1, 2)
    cloud = np.zeros(len(places), POINT)
    cloud["place"][:, :2] = places
    cloud["colour"][:, :3] = colours
    cloud["colour"][:, 3] = 255
    return cloud


def _cloud(time_ns: int, frame: str, cloud: NDArray[np.void]) -> PointCloud:
    return PointCloud(
        timestamp=stamp(time_ns),
        frame_id=frame,
        pose=pose(),
        point_stride=POINT.itemsize,
        fields=FIELDS,
        data=cloud.tobytes(),
    )
