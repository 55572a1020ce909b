"""One drive on a map of its track: the line by action, and the car with its sensor's rays at a few places.

Shapes: `T` time steps, `R` rays. Lengths are in metres, angles in radians counter-clockwise from +x.

Source: the paper's figure 2 (the track, the car, the gates; the green lines are its sensors).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carrl.render.canvas import Canvas, Floats, Stroke, View, text_width
from carrl.render.colours import BLACK, INK, LIGHT, PAPER
from carrl.render.figure import save_drawing
from carrl.render.scene import PRINT, draw_car, draw_cross, draw_line, draw_rays, ray_ends
from carrl.render.track_map import TrackMap
from carrl.tracks.track import Track

MOST_CARS = 6
"""At how many places along the drive the car is drawn."""
LEAST_GAP = 70.0
"""How far apart these places are at least, along the drive, points."""
FINEST = 2.0
"""The shortest stretch of one colour that is easy to see, points."""
_TEXT, _SWATCH, _SPACE = 8.5, 13.0, 12.0
"""Of the legend: height of its text, width of a sample, distance between two entries; points."""


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
    sensor_range: float,
    title: str,
    collided: bool = False,
) -> None:
    """Writes a picture of one drive, a .png, .pdf or .svg.

    Args:
        path: where to write it; the folder must exist.
        track: where it was driven.
        poses: x, y, heading in which each action was chosen, [T, 3], m, m, rad; or [T + 1, 3] with the last pose.
        ranges: distance to the wall along each ray at those poses, [T, R], m.
        sensor_angles: directions of the rays, [R], rad counter-clockwise from the heading.
        actions: indices into the names, [T].
        action_names: what each action is called.
        body_radius: radius of the car's disc, m.
        sensor_range: what a ray reads that meets no wall, m.
        title: one line above the map.
        collided: whether the drive ended at a wall; its end is then a cross instead of a ring.
    """
    track_map = TrackMap(track, title)
    steps = _steps_shown(poses[: len(ranges), :2], track_map.view.scale)
    lap = _Lap(poses, ranges, sensor_angles, actions, LIGHT.action_colours(len(action_names)), steps, collided)
    close_up = track_map.close_up(poses[steps, :2])

    def draw_scene(canvas: Canvas, view: View) -> None:
        lap.draw(canvas, view, body_radius, sensor_range)

    def draw(canvas: Canvas) -> None:
        track_map.draw(canvas)
        draw_scene(canvas, track_map.view)
        if close_up:
            track_map.draw_close_up(canvas, close_up, draw_scene)
        _draw_legend(canvas, track_map.size, lap, action_names)

    save_drawing(path, track_map.size, draw)


@dataclass(frozen=True, eq=False)
class _Lap:
    """What is drawn of a drive: as `draw_lap` has it, with the colours of the actions, and the steps with a car."""

    poses: Floats
    ranges: Floats
    sensor_angles: Floats
    actions: NDArray[np.integer]
    colours: Sequence[str]
    steps: Sequence[int]
    collided: bool

    def draw(self, canvas: Canvas, view: View, body_radius: float, sensor_range: float) -> None:
        """Draws the rays, the line, the car, and the end."""
        for step in self.steps:
            ends = ray_ends(self.poses[step], self.ranges[step], self.sensor_angles)
            colours = [LIGHT.ray] * len(ends)
            draw_rays(canvas, view, self.poses[step, :2], ends, colours, self.ranges[step] < sensor_range, PRINT)
        self._draw_line(canvas, view)
        for step in self.steps:
            draw_car(canvas, view, self.poses[step], body_radius, PRINT)
        if len(self.poses):
            self.draw_end(canvas, view.places(self.poses[-1, :2]))

    def draw_end(self, canvas: Canvas, place: Floats) -> None:
        """A cross for a collision, a ring for any other end."""
        if self.collided:
            draw_cross(canvas, place, 3.5, BLACK)
        else:
            canvas.disc(place, 3, PAPER, Stroke(INK, 1.2))

    def _draw_line(self, canvas: Canvas, view: View) -> None:
        """The way from each position to the next in the colour of the action that was chosen there.

        Steps too short to see would blend into grey; there, each stretch of FINEST shows its prevailing action.
        """
        positions = self.poses[:, :2]
        actions = self.actions[: max(0, len(positions) - 1)]
        points = max(_length(positions) * view.scale, FINEST)
        actions = prevailing_actions(actions, max(1, round(FINEST * len(actions) / points)))
        pieces = np.stack([positions[: len(actions)], positions[1 : len(actions) + 1]], axis=1)
        draw_line(canvas, view, pieces, actions, self.colours, PRINT.line.width(view))


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


def _draw_legend(canvas: Canvas, size: tuple[float, float], lap: _Lap, action_names: Sequence[str]) -> None:
    """Below the map at the right: what the colours mean, with each action's share of the steps, and the marks."""
    y, colours = size[1] - 14, lap.colours
    names = [*action_names, "car, sensor rays", "collision" if lap.collided else "end"]
    if len(lap.actions):
        shares = [round(100 * np.mean(lap.actions == action)) for action in range(len(action_names))]
        names[: len(shares)] = [f"{name} {share} %" for name, share in zip(names, shares, strict=False)]
    x = size[0] - 9
    for index, name in reversed(list(enumerate(names))):
        x -= text_width(name, _TEXT)
        canvas.text((x, y + 3), name, _TEXT, INK)
        x -= _SWATCH + 5
        ends, middle = [(x, y), (x + _SWATCH, y)], np.array([x + _SWATCH / 2, y])
        if index < len(colours):
            canvas.line(ends, Stroke(colours[index], 2.2))
        elif index == len(colours):
            canvas.line(ends, Stroke(LIGHT.ray, 0.9))
            canvas.disc(middle, 2.75, LIGHT.car, Stroke(INK, PRINT.outline.least))
        else:
            lap.draw_end(canvas, middle)
        x -= _SPACE
