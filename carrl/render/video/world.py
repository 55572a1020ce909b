"""The left of a frame: the track, the line driven so far, the car and its rays.

Shapes: `A` actions, `R` rays. Lengths in the world are in metres, in the picture in pixels.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import steps_of
from carrl.render.figure import FAINT, GREEN, INK, PAPER, VERMILLION, YELLOW
from carrl.render.video.camera import LEAST_SCALE, Area, View, follow_scale, whole
from carrl.render.video.canvas import Canvas, Stroke
from carrl.render.video.colours import OLD_TRAIL, TO_COME
from carrl.render.video.ground import draw_ground, draw_scale_bar
from carrl.render.wall_lines import connected_walls

AREA = Area(0, 56, 900, 664)
"""Of the picture, below the title and beside the panel."""
MARGIN = 34.0
"""Around a track that is shown as a whole, for the numbers of the gates."""
OVERVIEW = Area(16, 568, 204, 136)
"""A map in the corner, when the camera follows the car."""
TRAIL = 300
"""So many of the last steps are coloured by their action."""
FLASH = 5
"""For so many steps a gate lights up that was passed."""
NEAR = 0.1
"""A ray that reads less is drawn in red: the paper's threshold for too close to a wall."""


@dataclass(frozen=True, eq=False)
class World:
    """Draws an episode's world at any moment.

    Attributes:
        trace: the episode.
        colours: of its actions, [A].
    """

    trace: EpisodeTrace
    colours: tuple[str, ...]

    def draw(self, canvas: Canvas, step: int, share: float, pose: Floats, ranges: Floats) -> None:
        """Draws a moment: the step being made, how much of it is done, the car's pose [3] and rays [R], m."""
        view = self._view(pose)
        self._draw_ground(canvas, view, step)
        self._draw_trail(canvas, view, step, pose)
        self._draw_rays(canvas, view, pose, ranges)
        _draw_car(canvas, view, pose, self.trace.scene.body_radius)
        if share == 1 and self.trace.ended == "collision":
            _draw_cross(canvas, *view.pixels(pose[:2]))
        if self._follows:
            self._draw_overview(canvas, step, pose)
        canvas.box(0, 0, AREA.right, AREA.top, PAPER)

    @cached_property
    def _whole(self) -> View:
        return whole(self.trace.track, AREA.inset(MARGIN))

    @cached_property
    def _follow_scale(self) -> float:
        return follow_scale(self.trace.scene, AREA)

    @property
    def _follows(self) -> bool:
        return self._whole.scale < min(LEAST_SCALE, self._follow_scale)

    def _view(self, pose: Floats) -> View:
        return View(AREA, pose[:2], self._follow_scale) if self._follows else self._whole

    @cached_property
    def _known(self) -> NDArray[np.bool_]:
        """Whether the log tells where each step led, [T]."""
        return np.diff(steps_of(self.trace)) == 1

    @cached_property
    def _walls(self) -> list[Floats]:
        return connected_walls(self.trace.track)

    def _draw_ground(self, canvas: Canvas, view: View, step: int) -> None:
        lit = [gate for passed, gate in self.trace.passings if gate >= 0 and passed < step <= passed + FLASH]
        draw_ground(canvas, view, self._walls, self.trace.track.gates, lit)
        draw_scale_bar(canvas, view, left=OVERVIEW.right + 20 if self._follows else 24)

    def _draw_trail(self, canvas: Canvas, view: View, step: int, pose: Floats) -> None:
        """The line to the car's pose, old parts of it in grey; where the log lacks a step there is none."""
        way = view.pixels(np.vstack([self.trace.poses[: step + 1, :2], pose[None, :2]]))
        pieces = np.stack([way[:-1], way[1:]], axis=1)
        canvas.segments(pieces[:-TRAIL][self._known[: step + 1][:-TRAIL]], Stroke(OLD_TRAIL, 2))
        for action, colour in enumerate(self.colours):
            chosen = self._known & (self.trace.actions == action)
            canvas.segments(pieces[-TRAIL:][chosen[: step + 1][-TRAIL:]], Stroke(colour, 3.5))

    def _draw_rays(self, canvas: Canvas, view: View, pose: Floats, ranges: Floats) -> None:
        """Lines to where the rays end, with a dot where that is at a wall."""
        angles = pose[2] + self.trace.scene.sensor_angles
        ends = pose[:2] + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        for end, reach in zip(view.pixels(ends), ranges / self.trace.scene.sensor_range, strict=True):
            colour = VERMILLION if reach < NEAR else GREEN
            canvas.line([view.pixels(pose[:2]), end], Stroke(colour, 1.6))
            if reach < 1:
                canvas.disc(end, 4, colour)

    def _draw_overview(self, canvas: Canvas, step: int, pose: Floats) -> None:
        """The whole track in the corner, with the line driven and the car as a dot."""
        view = whole(self.trace.track, OVERVIEW.inset(12))
        canvas.box(OVERVIEW.left, OVERVIEW.top, OVERVIEW.width, OVERVIEW.height, PAPER, Stroke(FAINT, 1))
        centreline = self.trace.track.centreline
        canvas.area([view.pixels(centreline)], PAPER, Stroke(TO_COME, 3))
        canvas.line(view.pixels(self.trace.poses[: step + 1, :2]), Stroke(INK, 1.5))
        canvas.disc(view.pixels(pose[:2]), 5, YELLOW, Stroke(INK, 1.5))


def _draw_car(canvas: Canvas, view: View, pose: Floats, body_radius: float) -> None:
    """A disc with a stroke to its nose, larger than life where it would be too small to see."""
    radius = max(body_radius * view.scale, 6.0)
    middle = view.pixels(pose[:2])
    nose = middle + radius * np.array([np.cos(pose[2]), -np.sin(pose[2])])
    canvas.disc(middle, radius, YELLOW, Stroke(INK, 1.8))
    canvas.line([middle, nose], Stroke(INK, 2.2))


def _draw_cross(canvas: Canvas, x: float, y: float) -> None:
    """Marks a collision."""
    arms = np.array([[[x - 9, y - 9], [x + 9, y + 9]], [[x - 9, y + 9], [x + 9, y - 9]]])
    canvas.segments(arms, Stroke(PAPER, 9))
    canvas.segments(arms, Stroke(VERMILLION, 5))
