"""One drive on a map of its track: the line by action, and the car with its sensor's rays at a few places.

Shapes: `T` time steps, `R` rays. Lengths are in metres, angles in radians counter-clockwise from +x.

Source: the paper's figure 2 (the track, the car, the gates; the green lines are its sensors).
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import NDArray

from carrl.render.action_colours import action_colours
from carrl.render.close_up import draw_close_up
from carrl.render.figure import BLACK, GREEN, INK, YELLOW, save_figure
from carrl.render.track_map import Floats, TrackMap, draw_track_map
from carrl.tracks.track import Track

MOST_CARS = 6
"""At how many places along the drive the car is drawn."""
LEAST_GAP = 70.0
"""How far apart these places are at least, along the drive, points."""
TOUCH = 0.05
"""A ray that ends within this distance of a wall ends at it, m."""
FINEST = 2.0
"""The shortest stretch of one colour that is easy to see, points."""


def draw_lap(
    path: str | Path,
    track: Track,
    poses: Floats,
    ranges: Floats,
    sensor_angles: Floats,
    actions: NDArray[np.integer],
    *,
    action_names: Sequence[str],
    body_radius: float,
    title: str,
    collided: bool = False,
) -> None:
    """Writes a PNG of one drive.

    Args:
        path: where to write it; the folder must exist.
        track: where it was driven.
        poses: x, y, heading in which each action was chosen, [T, 3], m, m, rad; or [T + 1, 3] with the last pose.
        ranges: distance to the wall along each ray at those poses, [T, R], m.
        sensor_angles: directions of the rays, [R], rad counter-clockwise from the heading.
        actions: indices into the names, [T].
        action_names: what each action is called.
        body_radius: radius of the car's disc, m.
        title: one line above the map.
        collided: whether the drive ended at a wall; its end is then a cross instead of a ring.
    """
    track_map = draw_track_map(track, title)
    steps = _steps_shown(poses[: len(ranges), :2], track_map.scale)
    close_up = draw_close_up(track_map, track, poses[steps, :2])
    for view in filter(None, (track_map, close_up)):
        _draw_line(view, poses[:, :2], actions, action_colours(len(action_names)))
        for step in steps:
            _draw_rays(view, track, poses[step, :2], ray_ends(poses[step], ranges[step], sensor_angles))
            _draw_car(view, poses[step], body_radius)
        if len(poses) > 0:
            view.axes.add_line(_end_mark(collided, *poses[-1, :2]))
    _draw_legend(track_map, actions, action_names, collided)
    save_figure(track_map.figure, path)


def ray_ends(pose: Floats, ranges: Floats, sensor_angles: Floats) -> Floats:
    """Where the rays from a pose [3] with these ranges [R] end: [R, 2], m."""
    angles = pose[2] + sensor_angles
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(pose[:2] + ranges[:, None] * directions)


def same_action_stretches(actions: NDArray[np.integer]) -> list[tuple[int, int]]:
    """First step and step after the last of each stretch of one action, [T]."""
    changes = np.flatnonzero(np.diff(actions)) + 1
    return list(pairwise([0, *changes.tolist(), len(actions)])) if len(actions) else []


def prevailing_actions(actions: NDArray[np.integer], block: int) -> NDArray[np.integer]:
    """Each block's most frequent action in the place of all its actions, [T] to [T]."""
    starts = range(0, len(actions), block)
    prevailing = np.array([np.bincount(actions[start : start + block]).argmax() for start in starts], dtype=np.int64)
    return np.repeat(prevailing, block)[: len(actions)]


def _steps_shown(positions: Floats, scale: float) -> list[int]:
    """Steps of a drive [T, 2] at which to draw the car: evenly spread, away from both ends, not crowded."""
    steps = len(positions)
    cars = min(MOST_CARS, steps, max(1, int(_length(positions) * scale / LEAST_GAP)))
    return [int((car + 0.5) * steps / cars) for car in range(cars)]


def _length(positions: Floats) -> float:
    """Length of the way along the positions [T, 2], m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def _draw_line(track_map: TrackMap, positions: Floats, actions: NDArray[np.integer], colours: Sequence[str]) -> None:
    """The way from each position [T, 2] to the next in the colour of the action that was chosen there.

    Steps too short to see would blend into grey; there, each stretch of FINEST shows its prevailing action.
    """
    actions = actions[: max(0, len(positions) - 1)]
    points = max(_length(positions) * track_map.scale, FINEST)
    actions = prevailing_actions(actions, max(1, round(FINEST * len(actions) / points)))
    stretches = same_action_stretches(actions)
    lines = [positions[begin : end + 1] for begin, end in stretches]
    colour_of_line = [colours[actions[begin]] for begin, _ in stretches]
    width = track_map.width(0.5, least=1.5, most=2.2)
    track_map.axes.add_collection(
        LineCollection(lines, colors=colour_of_line, linewidths=width, capstyle="butt", zorder=5)
    )


def _draw_rays(track_map: TrackMap, track: Track, position: Floats, ends: Floats) -> None:
    """Thin lines from the car [2] to the ends [R, 2], with a dot where one ends at a wall and not at the full range."""
    rays = [np.stack([position, end]) for end in ends]
    width = track_map.width(0.2, least=0.5, most=0.9)
    track_map.axes.add_collection(LineCollection(rays, colors=GREEN, linewidths=width, zorder=4))
    walls = shapely.multilinestrings(shapely.linestrings(track.walls.double().numpy()))
    touching = ends[shapely.distance(shapely.points(ends), walls) < TOUCH]
    size = track_map.width(0.7, least=1.2, most=3.2)
    track_map.axes.plot(*touching.T, "o", color=GREEN, markersize=size, markeredgewidth=0, zorder=6)


def _draw_car(track_map: TrackMap, pose: Floats, body_radius: float) -> None:
    """The car's disc, to scale unless that is too small to see, with a stroke from its middle to its nose."""
    radius = track_map.width(body_radius, least=1.8, most=60.0) / track_map.scale
    nose = pose[:2] + radius * np.array([np.cos(pose[2]), np.sin(pose[2])])
    disc = Circle((pose[0], pose[1]), radius, facecolor=YELLOW, edgecolor=INK, linewidth=0.7, zorder=7)
    track_map.axes.add_patch(disc)
    track_map.axes.plot(*np.stack([pose[:2], nose]).T, color=INK, linewidth=0.8, zorder=7.1)


def _end_mark(collided: bool, x: float = 0.0, y: float = 0.0) -> Line2D:
    """A cross for a collision, a ring for any other end."""
    style: dict[str, Any] = {"marker": "X", "markersize": 10, "markerfacecolor": BLACK, "markeredgecolor": "white"}
    if not collided:
        style = {"marker": "o", "markersize": 6, "markerfacecolor": "white", "markeredgecolor": INK}
    return Line2D([x], [y], linestyle="none", markeredgewidth=1.2, zorder=9, **style)


def _draw_legend(
    track_map: TrackMap, actions: NDArray[np.integer], action_names: Sequence[str], collided: bool
) -> None:
    """Below the map at the right: what the colours mean, with each action's share of the steps, and the marks."""
    handles = []
    for action, (name, colour) in enumerate(zip(action_names, action_colours(len(action_names)), strict=True)):
        share = f" {round(100 * np.mean(actions == action))} %" if len(actions) else ""
        handles.append(Line2D([], [], color=colour, linewidth=2.2, label=f"{name}{share}"))
    rays = Line2D([], [], color=GREEN, linewidth=0.9, marker="o", markersize=5.5, label="car, sensor rays")
    rays.set(markerfacecolor=YELLOW, markeredgecolor=INK, markeredgewidth=0.7)
    end = _end_mark(collided)
    end.set_label("collision" if collided else "end")
    track_map.axes.legend(
        handles=[*handles, rays, end],
        loc="lower right",
        ncols=5,
        frameon=False,
        fontsize=8.5,
        handlelength=1.5,
        columnspacing=1.4,
        borderaxespad=0.6,
    )
