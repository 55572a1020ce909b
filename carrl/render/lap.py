"""One drive on a map of its track: the line by action or by speed, and the car with its sensor's rays at a few places.

Shapes: `T` time steps, `R` rays. Lengths are in metres, angles in radians counter-clockwise from +x.

Source: the paper's figure 2 (the track, the car, the gates; the green lines are its sensors).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carrl.log.trace import LEAST_SPREAD, ray_origins
from carrl.render.canvas import Canvas, Floats, Stroke, View, text_width
from carrl.render.car import draw_car, draw_others, draw_rays, ray_ends
from carrl.render.colours import BLACK, INK, LIGHT, PAPER
from carrl.render.curves import save_drawing
from carrl.render.scene import PRINT, draw_cross, draw_line
from carrl.render.track_map import TrackMap
from carrl.render.trail import speed_shades_of, speed_span

if TYPE_CHECKING:
    from carrl.log.scene import TrackShape
    from carrl.tracks.track import Track

MOST_CARS = 6
"""At how many places along the drive the car is drawn."""
LEAST_GAP = 70.0
"""How far apart these places are at least, along the drive, points."""
FINEST = 2.0
"""The shortest stretch of one colour that is easy to see, points."""
_TEXT, _SWATCH, _SPACE, _BAR, _SCALE_BAR = 8.5, 13.0, 12.0, 96.0, 120.0
"""Of the legend: height of its text, width of a sample, distance between two entries, width of a bar; points."""


def draw_lap(
    path: str | Path,
    track: "Track | TrackShape",
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
    speeds: Floats | None = None,
    body_size: tuple[float, float] | None = None,
    sensor_mount: float = 0.0,
    others: Floats | None = None,
) -> None:
    """Writes a picture of one drive, a .png, .pdf or .svg.

    Args:
        path: where to write it; the folder must exist.
        track: where it was driven.
        poses: x, y, heading in which each action was chosen, [T, 3], m, m, rad; or [T + 1, 3] with the last pose.
        ranges: distance to the wall along each ray at those poses, [T, R], m.
        sensor_angles: directions of the rays, [R], rad counter-clockwise from the heading.
        actions: indices into the names, [T]; anything of T rows where there are none.
        action_names: what each action is called; none where actions are numbers.
        body_radius: radius of the car's disc, m.
        sensor_range: what a ray reads that meets no wall, m.
        title: one line above the map.
        collided: whether the drive ended at a wall; its end is then a cross instead of a ring.
        speeds: at each pose, m/s, or none; where they do not vary the line has the colours of the actions.
        body_size: length and width of a car that is a rectangle, m.
        sensor_mount: how far ahead of the middle of the car the rays begin, m.
        others: poses of the other cars of the world at each pose, [T + 1, M, 3].
    """
    track_map = TrackMap(track, title)
    steps = _steps_shown(poses[: len(ranges), :2], track_map.view.scale)
    speeds = speeds if speeds is not None and np.ptp(speeds) >= LEAST_SPREAD else None
    if speeds is not None:
        colours, actions = LIGHT.speed_shades, speed_shades_of(speeds, *speed_span(speeds))
    else:
        colours = LIGHT.action_colours(max(1, len(action_names)))
        actions = actions if action_names else np.zeros(len(actions), dtype=np.int64)
    others = np.zeros((len(poses), 0, 3)) if others is None else others
    lap = _Lap(poses, ranges, sensor_angles, actions, colours, steps, collided, speeds, body_size, sensor_mount, others)
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
    """What is drawn of a drive: as `draw_lap` has it, with colours that `actions` counts, and the steps with a car."""

    poses: Floats
    ranges: Floats
    sensor_angles: Floats
    actions: NDArray[np.integer]
    colours: Sequence[str]
    steps: Sequence[int]
    collided: bool
    speeds: Floats | None
    body_size: tuple[float, float] | None
    sensor_mount: float
    others: Floats

    def draw(self, canvas: Canvas, view: View, body_radius: float, sensor_range: float) -> None:
        """Draws the rays, the line, the car, and the end."""
        for step in self.steps:
            pose, ranges = self.poses[step], self.ranges[step]
            ends = ray_ends(pose, ranges, self.sensor_angles, self.sensor_mount)
            origin = ray_origins(pose, self.sensor_mount)
            draw_rays(canvas, view, origin, ends, [LIGHT.ray] * len(ends), ranges < sensor_range, PRINT)
        self._draw_line(canvas, view)
        for step in self.steps:
            draw_others(canvas, view, self.others[step], body_radius, PRINT, self.body_size)
            draw_car(canvas, view, self.poses[step], body_radius, PRINT, body_size=self.body_size)
        if len(self.poses):
            self.draw_end(canvas, view.places(self.poses[-1, :2]))

    def draw_end(self, canvas: Canvas, place: Floats) -> None:
        """A cross for a collision, a ring for any other end."""
        if self.collided:
            draw_cross(canvas, place, 3.5, BLACK)
        else:
            canvas.disc(place, 3, PAPER, Stroke(INK, 1.2))

    def _draw_line(self, canvas: Canvas, view: View) -> None:
        """The way from each position to the next in the colour of the action that was chosen there, or of the speed.

        Steps too short to see would blend into grey; there, each stretch of FINEST shows its prevailing colour.
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
    x, y = size[0] - 9, size[1] - 14
    marks = ["car, sensor rays", "collision" if lap.collided else "end"]
    marks += ["another car"] if lap.others.size else []
    names, colours = _actions_named(lap, action_names, x - _SCALE_BAR - sum(map(_width, marks)))
    for index, name in reversed(list(enumerate([*names, *marks]))):
        x -= text_width(name, _TEXT)
        canvas.text((x, y + 3), name, _TEXT, INK)
        x -= _SWATCH + 5
        ends, middle = [(x, y), (x + _SWATCH, y)], np.array([x + _SWATCH / 2, y])
        if index < len(names):
            canvas.line(ends, Stroke(colours[index], 2.2))
        elif index == len(names):
            canvas.line(ends, Stroke(LIGHT.ray, 0.9))
            _draw_sample_car(canvas, middle, lap.body_size, LIGHT.car)
        elif index == len(names) + 1:
            lap.draw_end(canvas, middle)
        else:
            _draw_sample_car(canvas, middle, lap.body_size, LIGHT.other_car)
        x -= _SPACE
    if lap.speeds is not None:
        _draw_speed_bar(canvas, x, y, *speed_span(lap.speeds))


def _actions_named(lap: _Lap, names: Sequence[str], room: float) -> tuple[list[str], list[str]]:
    """Actions with their shares of the steps, and their colours; the most frequent ones where there is no room for all.

    None where the line has the colours of the speed.
    """
    if lap.speeds is not None:
        return [], []
    taken = np.bincount(lap.actions, minlength=len(names))
    texts = list(names)
    if len(lap.actions):
        texts = [f"{name} {round(100 * taken[action] / len(lap.actions))} %" for action, name in enumerate(names)]
    by_frequency = np.argsort(-taken[: len(names)], kind="stable").tolist()
    fitting = int((np.cumsum([_width(texts[action]) for action in by_frequency]) <= room).sum())
    shown = sorted(by_frequency[:fitting])
    return [texts[action] for action in shown], [lap.colours[action] for action in shown]


def _width(name: str) -> float:
    """Of an entry of the legend."""
    return text_width(name, _TEXT) + _SWATCH + 5 + _SPACE


def _draw_sample_car(canvas: Canvas, middle: Floats, body_size: tuple[float, float] | None, colour: str) -> None:
    edge = Stroke(INK, PRINT.outline.least)
    if body_size is None:
        canvas.disc(middle, 2.75, colour, edge)
    else:
        canvas.box(middle[0] - 4, middle[1] - 2, 8, 4, colour, edge)


def _draw_speed_bar(canvas: Canvas, right: float, y: float, low: float, high: float) -> None:
    """A bar of the line's colours with the speeds at both of its ends, the least and the greatest, and their unit."""
    greatest, least = f"{high:.3g} m/s", f"{low:.3g}"
    x = right - text_width(greatest, _TEXT)
    canvas.text((x, y + 3), greatest, _TEXT, INK)
    x -= _BAR + 5
    each = _BAR / len(LIGHT.speed_shades)
    for index, shade in enumerate(LIGHT.speed_shades):  # each to the end: no background shines through between two
        canvas.box(x + index * each, y - 3, _BAR - index * each, 6, shade)
    x -= 5 + text_width(least, _TEXT)
    canvas.text((x, y + 3), least, _TEXT, INK)
    x -= 7 + text_width("speed", _TEXT)
    canvas.text((x, y + 3), "speed", _TEXT, INK)
