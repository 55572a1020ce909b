"""The video of one episode: the drive on its track, with the network's Q-values and the rewards beside it.

Shapes: `F` frames, `T` steps, `R` rays.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carrl.files import write_whole
from carrl.log.trace import EpisodeTrace, ray_origins
from carrl.render import MOST_SEEN
from carrl.render.canvas import Area, Canvas, Floats, PixelCanvas, Stroke, View, fitted
from carrl.render.car import draw_car, draw_others, draw_rays, ray_ends
from carrl.render.colours import FAINT, GREEN, INK, LIGHT, PAPER, VERMILLION, YELLOW
from carrl.render.encoding import OLD_TRAIL, Encoding, encoded, encoding_for
from carrl.render.panel import EDGE, HEIGHT, WIDTH, Panel
from carrl.render.scene import (
    FILM,
    Ground,
    draw_cross,
    draw_ground,
    draw_line,
    draw_route,
    draw_scale_bar,
    light_gates,
    number_gates,
)
from carrl.render.trail import steps_of, trail_colours

PICTURES_PER_STEP, LEAST_RATE = 2, 20
"""So many pictures a step, or so many a second, are enough; more only take longer to draw."""
HOLD = 1.0
"""How long the last picture stays, s."""
AREA = Area(0, 56, 900, 664)
"""Of the picture, below the title and beside the panel."""
WORLD = Area(0, 0, EDGE, HEIGHT)
PANEL = Area(EDGE, 0, WIDTH - EDGE, HEIGHT)
MARGIN = 34.0
"""Around a track that is shown as a whole, for the numbers of the gates."""
OVERVIEW = Area(16, 568, 204, 136)
"""A map in the corner, when the camera follows the car."""
LEAST_SCALE = 5.0
"""Of a track that is shown as a whole, units per metre: with less, car and rays are too small to follow."""
CLOSEST_SCALE = 11.0
"""When the camera follows the car, at most, units per metre."""
RANGES_SEEN = 2.4
"""When the camera follows the car, it sees at least so many ranges of the sensor from top to bottom."""
TRAIL = 300
"""So many of the last steps are coloured by their action or speed."""
FLASH = 5
"""For so many steps a gate lights up that was passed."""
NEAR = 0.1
"""A ray that reads less is drawn in red: the paper's threshold for too close to a wall."""
JUMP = 0.2
"""A ray whose reading changes by more than this share of its range within a step has met another wall."""


def write_video(
    path: str | Path, trace: EpisodeTrace, title: str, progress: Callable[[int, int], None] = lambda done, of: None
) -> None:
    """Writes a video of an episode as fast as it was driven, whole or not at all.

    Args:
        path: where to write it; `.mp4` makes H.264, 1280 by 720 pixels, `.gif` a GIF of 640 by 360.
        trace: the episode.
        title: one line above the track; a long one is cut.
        progress: called with the pictures drawn and those to draw, after each.

    Raises:
        CarrlError: the name has another ending, PyAV is not installed, or the file cannot be written.
    """
    encoding = encoding_for(Path(path))
    rate = max(LEAST_RATE, round(PICTURES_PER_STEP / trace.scene.time_step))
    encoding = replace(encoding, rate=min(encoding.rate, rate))
    write_whole(path, encoded(encoding, _pictures(trace, title, encoding, progress)))


@dataclass(frozen=True, eq=False)
class Motion:
    """An episode at equally spaced times.

    Attributes:
        steps: the step that is being made, [F].
        shares: how much of it is done, [F], in [0, 1]; 1 only at the very end.
        poses: x m, y m, heading rad, [F, 3].
        others: of the other cars of the world, [F, M, 3].
        ranges: of the rays, [F, R], m.
    """

    steps: NDArray[np.int64]
    shares: Floats
    poses: Floats
    others: Floats
    ranges: Floats

    def __len__(self) -> int:
        """Frames, F."""
        return len(self.steps)


def motion_of(trace: EpisodeTrace, rate: float) -> Motion:
    """The episode at so many times per simulated second, the last one at its end."""
    steps_per_frame = 1 / (rate * trace.scene.time_step)
    # The margin keeps rounding from showing a step one frame late.
    progress = np.append(np.arange(0, len(trace) - 1e-6, steps_per_frame) + 1e-9, len(trace))
    steps = np.minimum(progress.astype(np.int64), len(trace) - 1)
    shares = progress - steps
    own = _poses_between(trace, trace.poses, steps, shares)
    others = [_poses_between(trace, trace.others[:, car], steps, shares) for car in range(trace.others.shape[1])]
    around = np.stack(others, axis=1) if others else np.zeros((len(steps), 0, 3))
    return Motion(steps, shares, own, around, _ranges_between(trace, steps, shares))


@dataclass(frozen=True, eq=False)
class WorldPicture:
    """The left of a frame: the track, the line driven so far, the car and its rays.

    Attributes:
        trace: the episode.
    """

    trace: EpisodeTrace

    def draw_still(self, canvas: Canvas) -> None:
        """Draws what no step changes: of a track that is shown as a whole, all of it."""
        if not self._follows:
            self._draw_track(canvas, self._whole)

    def draw_behind(self, canvas: Canvas, step: int) -> None:
        """Draws over that what does not move within a step: of a track that is shown as a whole, the line driven."""
        if not self._follows:
            self._draw_line(canvas, self._whole, step)

    def draw(self, canvas: Canvas, motion: Motion, frame: int) -> None:
        """Draws over both the step being made, the cars and the rays.

        Args:
            canvas: with what `draw_still` and `draw_behind` draw.
            motion: of the episode.
            frame: its row.
        """
        step, share, pose = int(motion.steps[frame]), float(motion.shares[frame]), motion.poses[frame]
        ranges, others = motion.ranges[frame], motion.others[frame]
        view = self._whole
        if self._follows:
            view = View(AREA, pose[:2], self._follow_scale)
            self._draw_track(canvas, view)
            self._draw_line(canvas, view, step)
        if self._known[step]:
            palette, shades = self._trail_colours
            piece = np.stack([self.trace.poses[step, :2], pose[:2]])[None]
            draw_line(canvas, view, piece, shades[step : step + 1], palette, FILM.line.width(view))
        scene = self.trace.scene
        reaches = ranges / scene.sensor_range
        colours = [VERMILLION if reach < NEAR else GREEN for reach in reaches]
        ends = ray_ends(pose, ranges, scene.sensor_angles, scene.sensor_mount)
        draw_rays(canvas, view, ray_origins(pose, scene.sensor_mount), ends, colours, reaches < 1, FILM)
        draw_others(canvas, view, others, scene.body_radius, FILM, scene.body_size)
        draw_car(canvas, view, pose, scene.body_radius, FILM, body_size=scene.body_size)
        if share == 1 and self.trace.ended == "collision":
            draw_cross(canvas, view.places(pose[:2]), 9, VERMILLION)
        if self._follows:
            draw_scale_bar(canvas, view, OVERVIEW.right + 20, AREA.bottom - 18, FILM)
            self._draw_overview(canvas, step, pose, others)
        canvas.box(0, 0, AREA.right, AREA.top, PAPER)

    def _draw_track(self, canvas: Canvas, view: View) -> None:
        draw_ground(canvas, view, self._ground, FILM)
        _draw_direction(canvas, view.places(self._ground.gates[-1]))
        number_gates(canvas, view, self._ground.gates, 15, len(self._ground.gates), FAINT)
        if not self._follows:
            draw_scale_bar(canvas, view, 24, AREA.bottom - 18, FILM)

    @cached_property
    def _passings(self) -> list[tuple[int, int]]:
        return [(row, gate) for row, gate in self.trace.passings if gate >= 0]

    @cached_property
    def _ground(self) -> Ground:
        return Ground.of(self.trace.track)

    @cached_property
    def _whole(self) -> View:
        return View.whole(self._ground.bounds, AREA.inset(MARGIN))

    @cached_property
    def _follow_scale(self) -> float:
        return min(CLOSEST_SCALE, AREA.height / (RANGES_SEEN * min(self.trace.scene.sensor_range, MOST_SEEN)))

    @property
    def _follows(self) -> bool:
        return self._whole.scale < min(LEAST_SCALE, self._follow_scale)

    @cached_property
    def _known(self) -> NDArray[np.bool_]:
        """Whether the log tells where each step led, [T]."""
        return np.diff(steps_of(self.trace)) == 1

    @cached_property
    def _trail_colours(self) -> tuple[tuple[str, ...], NDArray[np.int64]]:
        return trail_colours(self.trace, LIGHT)

    def _draw_line(self, canvas: Canvas, view: View, step: int) -> None:
        """Gates just passed, and the line to where a step begins, old parts in grey; unlogged steps have none."""
        lit = [gate for passed, gate in self._passings if passed < step <= passed + FLASH]
        light_gates(canvas, view, self._ground, FILM, lit)
        way, known = self.trace.poses[: step + 1, :2], self._known[:step]
        pieces = np.stack([way[:-1], way[1:]], axis=1)
        palette, colours = [*self._trail_colours[0], OLD_TRAIL], self._trail_colours[1][:step].copy()
        colours[: max(0, step + 1 - TRAIL)] = len(palette) - 1
        draw_line(canvas, view, pieces[known], colours[known], palette, FILM.line.width(view))

    def _draw_overview(self, canvas: Canvas, step: int, pose: Floats, others: Floats) -> None:
        """The whole track in the corner, with the line driven and the cars as dots."""
        view = View.whole(self._ground.bounds, OVERVIEW.inset(12))
        canvas.box(OVERVIEW.left, OVERVIEW.top, OVERVIEW.width, OVERVIEW.height, PAPER, Stroke(FAINT, 1))
        draw_route(canvas, view, self._ground, Stroke(LIGHT.centreline, 3))
        canvas.line(view.places(self.trace.poses[: step + 1, :2]), Stroke(INK, 1.5))
        for place in view.places(others[:, :2]):
            canvas.disc(place, 4, LIGHT.other_car, Stroke(INK, 1))
        canvas.disc(view.places(pose[:2]), 5, YELLOW, Stroke(INK, 1.5))


def _pictures(
    trace: EpisodeTrace, title: str, encoding: Encoding, progress: Callable[[int, int], None]
) -> Iterator[NDArray[np.uint8]]:
    """Every picture of the video, the last one as often as it takes to hold it."""
    canvas, still, behind, figures = (PixelCanvas(WIDTH, HEIGHT, encoding.width / WIDTH) for _ in range(4))
    motion = motion_of(trace, encoding.rate)
    world, panel = WorldPicture(trace), Panel(trace, LIGHT.action_colours(len(trace.scene.action_names)))
    still.clear(PAPER)
    world.draw_still(still)
    shown: tuple[int, bool] | None = None
    for frame in range(len(motion)):
        step, share = int(motion.steps[frame]), float(motion.shares[frame])
        now = step, share == 1
        if now != shown:  # of which each has several pictures
            behind.copy(still, WORLD)
            world.draw_behind(behind, step)
            panel.draw(figures, step, float(share == 1))
            shown = now
        canvas.copy(behind, WORLD)
        world.draw(canvas, motion, frame)
        canvas.copy(figures, PANEL)
        _draw_title(canvas, trace, title, over=frame == len(motion) - 1)
        yield canvas.pixels
        progress(frame + 1, len(motion))
    for _ in range(round(HOLD * encoding.rate)):
        yield canvas.pixels


def _draw_title(canvas: Canvas, trace: EpisodeTrace, title: str, over: bool) -> None:
    """The title and, when it is over, how the episode ended."""
    canvas.text((24, 38), fitted(title, 22, 560), 22, INK, bold=True)
    if over:
        what = "the record ends" if trace.ended == "unfinished" else trace.ended
        colour = VERMILLION if trace.ended == "collision" else FAINT
        duration = (trace.columns["step"][-1] + 1) * trace.scene.time_step
        canvas.text((884, 38), f"{what} after {duration:,.1f} s", 20, colour, bold=True, anchor="rs")


def _draw_direction(canvas: Canvas, line: Floats) -> None:
    """Before the start line, from its left to its right end [2, 2], a triangle in the driving direction."""
    across = (line[1] - line[0]) / max(1e-9, float(np.linalg.norm(line[1] - line[0])))
    forward, middle = np.array([across[1], -across[0]]), line.mean(axis=0)
    canvas.area([[middle + 8 * forward + 7 * across, middle + 8 * forward - 7 * across, middle + 20 * forward]], INK)


def _poses_between(trace: EpisodeTrace, poses: Floats, steps: NDArray[np.int64], shares: Floats) -> Floats:
    """On the arcs of constant curvature from each of a car's poses [T + 1, 3] to the next, [F, 3].

    The first one where a step is missing.
    """
    known = np.diff(steps_of(trace)) == 1
    begin, end = poses[steps], poses[steps + known[steps]]
    chord = end[:, :2] - begin[:, :2]
    yaw = (end[:, 2] - begin[:, 2] + np.pi) % (2 * np.pi) - np.pi
    # A part of an arc has a shorter chord, turned back by half of the turn that is still to come.
    length = np.linalg.norm(chord, axis=1) * shares * np.sinc(shares * yaw / 2 / np.pi) / np.sinc(yaw / 2 / np.pi)
    direction = np.arctan2(chord[:, 1], chord[:, 0]) - (1 - shares) * yaw / 2
    return np.column_stack(
        [
            begin[:, 0] + length * np.cos(direction),
            begin[:, 1] + length * np.sin(direction),
            begin[:, 2] + shares * yaw,
        ]
    )


def _ranges_between(trace: EpisodeTrace, steps: NDArray[np.int64], shares: Floats) -> Floats:
    """Ranges in proportion, or where a ray leaves one wall for another, the nearer of the two in time, [F, R]."""
    known = np.diff(steps_of(trace)) == 1
    begin, end = trace.ranges[steps], trace.ranges[steps + known[steps]]
    share = shares[:, None]
    jumps = np.abs(end - begin) > JUMP * trace.scene.sensor_range
    return np.asarray(begin + np.where(jumps, share >= 0.5, share) * (end - begin))
