"""The map: track, car, rays and driven line, in metres, y to the left of x, and the frames they are seen from.

Shapes: `T` steps, `R` rays, `N` lines of `P` points.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from carrl.export.rerun.step_stream import StepStream
from carrl.log.scene import Floats, TrackShape
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import driven_ways, ray_hits
from carrl.render.viewer_palette import CAR, CENTRELINE, GATE, RAY, START, WALL, Colour, action_colours

MAP_FRAME, CLOSE_UP_FRAME = "map", "follow/close_up"
"""From these entities the world looks right: Rerun's 2D views have y downwards, and here it is turned up."""
SMALLEST_CAR = 4.5
"""Radius of the dot that marks the car on the map of a long circuit, points."""
LARGE = 200.0
"""Extent of a circuit from which on its walls are drawn thin, m."""


def send_frames(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends a frame that stands still, and one that goes with the car without turning."""
    positions = np.pad(trace.poses[:, :2], ((0, 0), (0, 1)))
    stream.send("follow", range(len(positions)), rr.Transform3D.columns(translation=positions))
    for frame in (MAP_FRAME, CLOSE_UP_FRAME):
        stream.send_static(frame, rr.Transform3D.from_fields(scale=[1, -1, 1]))


def send_track(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends walls, gates and centreline; the last gate is the start line."""
    track = trace.track
    loop = np.vstack([track.centreline, track.centreline[:1]])
    gate_colours = [GATE] * (len(track.gates) - 1) + [START]
    stream.send_static("track/centreline", _lines(loop[None], [CENTRELINE], width=1.0))
    stream.send_static("track/gates", _lines(track.gates, gate_colours, width=1.0))
    stream.send_static("track/walls", _lines(track.walls, [WALL], width=_wall_width(track)))


def send_trail(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends the way of each step, in the colour of its action, at the moment when it has been driven."""
    palette = np.array(action_colours(len(trace.scene.action_names)), dtype=np.uint8)
    rows, ways = driven_ways(trace)
    columns = rr.LineStrips2D.columns(strips=ways.astype(np.float32), colors=palette[trace.actions[rows]])
    stream.send("car/trail", rows + 1, columns)
    stream.send_static("car/trail", rr.LineStrips2D.from_fields(radii=_width(1.6), draw_order=21))


def send_car(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends the car's disc, with a dot in it that never gets too small to see, and its heading."""
    rows, middles, headings = range(len(trace) + 1), trace.poses[:, :2], trace.poses[:, 2]
    noses = 4 * trace.scene.body_radius * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    discs = rr.Points2D.columns(positions=np.repeat(middles, 2, axis=0)).partition([2] * len(rows))
    stream.send("car/body", rows, [*discs, *rr.Arrows2D.columns(origins=middles, vectors=noses)])
    radii = [trace.scene.body_radius, _width(SMALLEST_CAR)]
    stream.send_static("car/body", rr.Points2D.from_fields(radii=radii, colors=[CAR], draw_order=31))
    stream.send_static("car/body", rr.Arrows2D.from_fields(radii=_width(1.6), colors=[CAR], draw_order=30))


def send_rays(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends the rays, with dots where they meet a wall."""
    rows, ends = range(len(trace) + 1), trace.ray_ends()
    rays = np.stack([np.broadcast_to(trace.poses[:, None, :2], ends.shape), ends], axis=2).reshape(-1, 2, 2)
    hits = ray_hits(trace)
    lines = rr.LineStrips2D.columns(strips=rays.astype(np.float32)).partition([ends.shape[1]] * len(rows))
    dots = rr.Points2D.columns(positions=ends[hits]).partition(hits.sum(axis=1))
    stream.send("car/rays", rows, [*lines, *dots])
    stream.send_static("car/rays", rr.LineStrips2D.from_fields(radii=_width(0.7), colors=[RAY], draw_order=22))
    stream.send_static("car/rays", rr.Points2D.from_fields(radii=_width(2.8), colors=[RAY], draw_order=23))


def _wall_width(track: TrackShape) -> float:
    """Half as much on long circuits, where the map would show no road between the walls, points."""
    left, bottom, right, top = track.bounds
    return 1.4 if max(right - left, top - bottom) < LARGE else 0.7


def _lines(points: Floats, colours: Sequence[Colour], width: float) -> rr.LineStrips2D:
    """Lines [N, P, 2], m, in one colour for all or one for each, of a width on the screen, points."""
    return rr.LineStrips2D(points.astype(np.float32), colors=colours, radii=_width(width))


def _width(points: float) -> float:
    """A radius that stays the same on the screen when one zooms; Rerun takes negative ones so."""
    return -points
