"""The video of laps against each other: all cars cross the start line at once, with speeds and gaps over the way.

Shapes: `F` frames, `K` stations.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carrl.files import write_whole
from carrl.racing.laps import Floats, Lap
from carrl.render import round_ticks
from carrl.render.canvas import Area, Canvas, PixelCanvas, Stroke, View, fitted
from carrl.render.car import placed
from carrl.render.colours import FAINT, INK, LAPS, PAPER, blend
from carrl.render.encoding import RULE, Encoding, encoded, encoding_for
from carrl.render.panel import HEIGHT, WIDTH
from carrl.render.scene import FILM, Ground, draw_ground, draw_scale_bar
from carrl.tracks.track import Track

HOLD = 2.0
"""How long the last picture stays, s."""
MAP, CLOSE_UP = Area(0, 50, 880, 392), Area(892, 430, 372, 274)
SPEED, GAP = Area(64, 466, 800, 96), Area(64, 596, 800, 96)
"""The charts."""
LEFT, RIGHT, FIRST_ROW, ROW = 900.0, 1256.0, 64.0, 57.0
"""The list of the laps."""
MARGIN = 30.0
ROADS_SEEN, CLOSER = 8.0, 2.0
"""The close-up is at least so many widths of the road high, and at least so many times larger than the map."""
POINTS = 400
"""Of a line in a chart."""
_HEAD = np.array([[1.2, 0.0], [-1.0, 0.85], [-0.5, 0.0], [-1.0, -0.85]])
_HEAD_SIZE = 10.0
"""Half the length of a car's arrowhead, units."""


def write_laps_video(
    path: str | Path, track: Track, laps: Sequence[Lap], drawn: Callable[[int, int], None] = lambda done, of: None
) -> None:
    """Writes a video of laps, whose gaps are to the first one, as fast as they were driven, whole or not at all.

    Args:
        path: where to write it, as in `carrl.render.video.write_video`.
        track: where they were driven.
        laps: to be shown.
        drawn: called with the pictures drawn and those to draw, after each.

    Raises:
        CarrlError: the name has another ending, PyAV is not installed, or the file cannot be written.
    """
    encoding = encoding_for(Path(path))
    write_whole(path, encoded(encoding, _pictures(track, laps, encoding, drawn)))


def _pictures(
    track: Track, laps: Sequence[Lap], encoding: Encoding, drawn: Callable[[int, int], None]
) -> Iterator[NDArray[np.uint8]]:
    duration = max(lap.end[1] for lap in laps)
    times = np.append(np.arange(math.ceil(duration * encoding.rate)) / encoding.rate, duration)
    race = _Race(track, laps, encoding.width / WIDTH)
    canvas = PixelCanvas(WIDTH, HEIGHT, encoding.width / WIDTH)
    states = [lap.at(times) for lap in laps]
    for frame, time in enumerate(times.tolist()):
        cars = [_Car(poses[frame], stations[frame], speeds[frame]) for poses, stations, speeds in states]
        race.draw(canvas, time, cars)
        yield canvas.pixels
        drawn(frame + 1, len(times))
    for _ in range(round(HOLD * encoding.rate)):
        yield canvas.pixels


@dataclass(frozen=True, eq=False)
class _Car:
    """A car in a frame: its pose [3], station, m, and speed, m/s."""

    pose: Floats
    station: float
    speed: float


@dataclass(frozen=True, eq=False)
class _Chart:
    """A line for each lap over the way along the road, [K] each."""

    area: Area
    name: str
    stations: Floats
    lines: Sequence[Floats]
    low: float
    high: float

    def draw_still(self, canvas: Canvas) -> None:
        """Draws its name, its axes, and all lines faintly."""
        area = self.area
        canvas.text((area.left, area.top - 9), self.name, 15, FAINT)
        for value in round_ticks(self.low, self.high, 3):
            y = float(self._y(value))
            canvas.line([(area.left, y), (area.right, y)], Stroke(RULE, 1))
            canvas.text((area.left - 8, y + 5), f"{value:g}", 14, FAINT, anchor="rs")
        for line, colour in zip(self.lines, LAPS, strict=False):
            self._draw_line(canvas, line, blend(PAPER, colour, 0.3), 1.5, self.stations[-1])

    def draw(self, canvas: Canvas, cars: Sequence[_Car]) -> None:
        """Draws the lines as far as the cars have come."""
        for line, colour, car in reversed(list(zip(self.lines, LAPS, cars, strict=False))):
            self._draw_line(canvas, line, colour, 2.5, car.station)
            here = float(np.interp(car.station, self.stations, line))
            if not np.isnan(here):
                canvas.disc((self._x(car.station), self._y(here)), 5, colour, Stroke(PAPER, 1.5))

    def _draw_line(self, canvas: Canvas, line: Floats, colour: str, width: float, end: float) -> None:
        shown = (self.stations <= end) & ~np.isnan(line)
        if shown.sum() > 1:
            canvas.line(np.column_stack([self._x(self.stations[shown]), self._y(line[shown])]), Stroke(colour, width))

    def _x(self, stations: Floats | float) -> Floats:
        return np.asarray(self.area.left + self.area.width * stations / self.stations[-1])

    def _y(self, values: Floats | float) -> Floats:
        return np.asarray(self.area.bottom - self.area.height * (values - self.low) / (self.high - self.low))


@dataclass(frozen=True, eq=False)
class _Race:
    """Draws the laps at any time on pictures of a scale, pixels per unit."""

    track: Track
    laps: Sequence[Lap]
    scale: float

    def draw(self, canvas: PixelCanvas, time: float, cars: Sequence[_Car]) -> None:
        """Draws a frame."""
        canvas.paste(self._still, 0, 0)
        canvas.text((RIGHT, 34), f"{time:,.1f} s", 22, INK, bold=True, anchor="rs")
        for chart in self._charts:
            chart.draw(canvas, cars)
        self._draw_cars(canvas, self._whole, cars)
        self._draw_list(canvas, time, cars)
        self._draw_close_up(canvas, cars)

    @cached_property
    def _ground(self) -> Ground:
        return Ground.of(self.track)

    @cached_property
    def _whole(self) -> View:
        return View.whole(self._ground.bounds, MAP.inset(MARGIN))

    @cached_property
    def _close_up_scale(self) -> float:
        left, right = self._ground.gates[-1]
        return max(CLOSE_UP.height / (ROADS_SEEN * float(np.linalg.norm(left - right))), CLOSER * self._whole.scale)

    @cached_property
    def _charts(self) -> tuple[_Chart, _Chart]:
        stations = np.linspace(0, self.track.length, POINTS)
        speeds = [lap.speed_at(stations) for lap in self.laps]
        gaps = [lap.gap_to(self.laps[0], stations) for lap in self.laps]
        low, high = (float(limit(np.concatenate(gaps))) for limit in (np.nanmin, np.nanmax))
        high = high if high > low else low + 1
        return (
            _Chart(SPEED, "speed, m/s", stations, speeds, 0.0, 1.05 * float(np.nanmax(np.concatenate(speeds)))),
            _Chart(GAP, f"gap to {self.laps[0].name[:40]}, s; up: behind", stations, gaps, low, high),
        )

    @cached_property
    def _still(self) -> PixelCanvas:
        """What stays the same."""
        canvas = PixelCanvas(WIDTH, HEIGHT, self.scale)
        canvas.clear(PAPER)
        canvas.text((24, 34), fitted(f"Laps of {self.track.name}", 22, 800), 22, INK, bold=True)
        draw_ground(canvas, self._whole, self._ground, FILM)
        self._draw_ways(canvas, self._whole, 1.5)
        draw_scale_bar(canvas, self._whole, 24, MAP.bottom - 10, FILM)
        for chart in self._charts:
            chart.draw_still(canvas)
        for index, (lap, colour) in enumerate(zip(self.laps, LAPS, strict=False)):
            y = FIRST_ROW + index * ROW
            canvas.box(LEFT, y + 3, 14, 14, colour)
            canvas.text((LEFT + 24, y + 17), fitted(_named(lap), 18, 320), 18, INK, bold=index == 0)
        return canvas

    def _draw_ways(self, canvas: Canvas, view: View, width: float) -> None:
        for lap, colour in reversed(list(zip(self.laps, LAPS, strict=False))):
            canvas.line(view.places(lap.poses[:, :2]), Stroke(colour, width))

    def _draw_cars(self, canvas: Canvas, view: View, cars: Sequence[_Car]) -> None:
        """Arrowheads, that of the first lap on top."""
        for car, colour in reversed(list(zip(cars, LAPS, strict=False))):
            head = placed(_HEAD * _HEAD_SIZE / view.scale, car.pose)
            canvas.area([view.places(head)], colour, Stroke(PAPER, 1.5))

    def _draw_list(self, canvas: Canvas, time: float, cars: Sequence[_Car]) -> None:
        """Speed and gap of each car where it is, or its lap time when it has come round."""
        for index, (lap, car) in enumerate(zip(self.laps, cars, strict=True)):
            y = FIRST_ROW + index * ROW + 41
            if time >= lap.end[1]:
                text = "ended" if lap.lap_time is None else f"{lap.lap_time:.2f} s"
                canvas.text((LEFT + 24, y), text, 20, INK, bold=True)
            else:
                canvas.text((LEFT + 24, y), f"{car.speed:.1f} m/s", 18, FAINT)
            gap = lap.gap_to(self.laps[0], np.array([car.station]))[0]
            if index and not np.isnan(gap):
                canvas.text((RIGHT, y), f"{gap:+.2f} s", 22, INK, bold=True, anchor="rs")

    def _draw_close_up(self, canvas: Canvas, cars: Sequence[_Car]) -> None:
        """The surroundings of the first lap's car."""
        view = View(CLOSE_UP, cars[0].pose[:2], self._close_up_scale)
        with canvas.clipped(CLOSE_UP):
            draw_ground(canvas, view, self._ground, FILM)
            self._draw_ways(canvas, view, 2)
            self._draw_cars(canvas, view, cars)
        corners = [(CLOSE_UP.left, CLOSE_UP.top), (CLOSE_UP.right, CLOSE_UP.bottom)]
        (left, top), (right, bottom) = corners
        canvas.line([(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], Stroke(RULE, 2))


def _named(lap: Lap) -> str:
    return f"{lap.name} (from rest)" if lap.is_standing else lap.name
