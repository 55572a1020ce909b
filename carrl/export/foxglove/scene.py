"""What Foxglove draws: track, driven line, car and rays as scenes, and frames, poses and the scan as such.

Shapes: `T` steps, `R` rays.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    CylinderPrimitive,
    FrameTransform,
    LaserScan,
    LinePrimitive,
    LinePrimitiveLineType,
    PoseInFrame,
    PosesInFrame,
    SceneEntity,
    SceneUpdate,
    Vector3,
)

from carrl.export.foxglove.entry import CAR_FRAME, WORLD_FRAME, Entry, colour, points, pose, rotation, stamp, times_ns
from carrl.log.scene import Floats, Scene
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import driven_ways, ray_directions
from carrl.render.viewer_palette import CAR, CENTRELINE, GATE, RAY, START, WALL, Colour, action_colours

_LIST, _LOOP = LinePrimitiveLineType.LineList, LinePrimitiveLineType.LineLoop


def scene_entries(trace: EpisodeTrace) -> Iterator[Entry]:
    """Yields all messages that are drawn: first what stays, then what moves."""
    times = times_ns(trace)
    yield Entry.of(times[0], "/track", _scene(times[0], WORLD_FRAME, "track", _track_lines(trace)))
    yield Entry.of(times[0], "/drive", _scene(times[0], WORLD_FRAME, "drive", [_driven_line(trace)]))
    yield Entry.of(times[0], "/drive/poses", _driven_poses(times[0], trace))
    yield Entry.of(times[0], "/car", _car(times[0], trace.scene.body_radius))
    for time_ns, place, ranges in zip(times, trace.poses.tolist(), trace.ranges, strict=True):
        yield Entry.of(time_ns, "/tf", _transform(time_ns, *place))
        in_world = PoseInFrame(timestamp=stamp(time_ns), frame_id=WORLD_FRAME, pose=pose(*place))
        yield Entry.of(time_ns, "/car/pose", in_world)
        yield Entry.of(time_ns, "/car/scan", _scan(time_ns, ranges, trace.scene))
        yield Entry.of(time_ns, "/car/rays", _scene(time_ns, CAR_FRAME, "rays", [_rays(ranges, trace.scene)]))


def _track_lines(trace: EpisodeTrace) -> list[LinePrimitive]:
    """Walls, gates, start line and centreline."""
    track = trace.track
    return [
        _line(track.walls, WALL, width=3.0),
        _line(track.gates[:-1], GATE, width=2.0),
        _line(track.gates[-1:], START, width=2.0),
        _line(track.centreline, CENTRELINE, width=1.0, kind=_LOOP),
    ]


def _driven_line(trace: EpisodeTrace) -> LinePrimitive:
    """The way of each step in the colour of its action."""
    palette = [colour(shade) for shade in action_colours(len(trace.scene.action_names))]
    rows, ways = driven_ways(trace)
    colours = [palette[action] for action in np.repeat(trace.actions[rows], 2)]
    return LinePrimitive(type=_LIST, thickness=2.0, scale_invariant=True, points=points(ways), colors=colours)


def _driven_poses(time_ns: int, trace: EpisodeTrace) -> PosesInFrame:
    poses = [pose(*place) for place in trace.poses.tolist()]
    return PosesInFrame(timestamp=stamp(time_ns), frame_id=WORLD_FRAME, poses=poses)


def _car(time_ns: int, radius: float) -> SceneUpdate:
    """A flat disc with an arrow ahead, which go with the car's frame."""
    size = Vector3(x=2 * radius, y=2 * radius, z=radius / 2)
    disc = CylinderPrimitive(pose=pose(), size=size, bottom_scale=1.0, top_scale=1.0, color=colour(CAR))
    arrow = ArrowPrimitive(
        pose=pose(),
        shaft_length=3 * radius,
        shaft_diameter=radius / 2,
        head_length=radius,
        head_diameter=radius,
        color=colour(CAR),
    )
    entity = SceneEntity(
        timestamp=stamp(time_ns), frame_id=CAR_FRAME, id="car", frame_locked=True, cylinders=[disc], arrows=[arrow]
    )
    return SceneUpdate(entities=[entity])


def _transform(time_ns: int, x: float, y: float, heading: float) -> FrameTransform:
    """Where the car's frame is in the world."""
    return FrameTransform(
        timestamp=stamp(time_ns),
        parent_frame_id=WORLD_FRAME,
        child_frame_id=CAR_FRAME,
        translation=Vector3(x=x, y=y),
        rotation=rotation(heading),
    )


def _scan(time_ns: int, ranges: Floats, scene: Scene) -> LaserScan:
    """The ranges [R], m; infinity, as is the custom, of a ray that meets nothing."""
    found = np.where(ranges < scene.sensor_range, ranges, np.inf).tolist()
    first, last = scene.sensor_angles[[0, -1]].tolist()
    return LaserScan(
        timestamp=stamp(time_ns), frame_id=CAR_FRAME, pose=pose(), start_angle=first, end_angle=last, ranges=found
    )


def _rays(ranges: Floats, scene: Scene) -> LinePrimitive:
    """Lines from the car along the ranges [R], m, in the car's frame."""
    ends = ranges[:, None] * ray_directions(scene)
    return _line(np.stack([np.zeros_like(ends), ends], axis=1), RAY, width=1.5)


def _line(
    places: Floats, shade: Colour, width: float, kind: LinePrimitiveLineType = LinePrimitiveLineType.LineList
) -> LinePrimitive:
    """Lines between each two of the places [..., 2], m, or a loop through all; their width in pixels."""
    return LinePrimitive(type=kind, thickness=width, scale_invariant=True, points=points(places), color=colour(shade))


def _scene(time_ns: int, frame: str, name: str, lines: Sequence[LinePrimitive]) -> SceneUpdate:
    """A scene of one thing made of lines, in the place of what it was before."""
    entity = SceneEntity(timestamp=stamp(time_ns), frame_id=frame, id=name, lines=list(lines))
    return SceneUpdate(entities=[entity])
