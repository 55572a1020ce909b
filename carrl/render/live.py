"""Pictures of cars as they drive: one that follows a car, and one of all cars on the whole track.

Shapes: `B` cars, `R` rays, `T` time steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carrl.log.trace import ray_origins
from carrl.render import MOST_SEEN
from carrl.render.canvas import Area, Floats, Picture, PixelCanvas, Stroke, View, fitted, text_width
from carrl.render.car import draw_car, draw_others, draw_rays, placed, ray_ends
from carrl.render.colours import DARK, ORANGE, PURPLE, SKY, YELLOW, blend, nearness_colour
from carrl.render.scene import (
    SCREEN,
    Ground,
    draw_ground,
    draw_line,
    draw_route,
    draw_scale_bar,
)
from carrl.tracks.track import Track

Size = tuple[int, int]
SIZE: Size = (640, 480)
"""Of a picture, unless another is asked for, px."""
MARGIN = 8
"""Between a panel and the rim of its picture, px."""
LEAST_VIEW = 24.0
"""Height of what the picture shows, m; more where the rays reach farther."""
FLEET = (YELLOW, SKY, ORANGE, PURPLE, DARK.ray)
"""Colours of the cars in the picture of all, in turn."""
PANEL, TRAIL = "#12171b", SKY
_MAP_SIZE = (150, 122)
_FIGURES_SIZE = (150, 135)
_LEGEND_SIZE = (150, 34)
_FIRST_ROW, _ROW = 20, 17
"""Base line of the first figure, and distance to the next, px."""
_ARROW = np.array([[-0.8, -0.65], [-0.45, 0.0], [-0.8, 0.65], [1.1, 0.0]])  # a car, in body radii, nose to +x
_TRAIL_SHADES = 8


@dataclass(frozen=True)
class CarSnapshot:
    """A car at one point of its episode.

    Attributes:
        pose: x m, y m, heading rad counter-clockwise from +x, [3].
        readings: distance along each ray / range, [R], in 0..1.
        next_gate: index of the gate that counts next.
        gates_passed: since the start.
        step: steps since the start.
        steer: how far the wheel is turned, -1 right to 1 left
        action: what the last action is called.
        episode_return: sum of the rewards since the start.
        collided: the car touched a wall in the last step.
        trail: where the car was before, oldest first, [T, 2], m.
        track: index of what it drives on.
        speed: m/s; None of a car whose speed never varies.
        others: poses of the other cars of its world, [M, 3].
        hit_car: it touched another car, which ended its episode.
    """

    pose: Floats
    readings: Floats
    next_gate: int
    gates_passed: int
    step: int
    steer: float
    action: str
    episode_return: float
    collided: bool = False
    trail: Sequence[Floats] = ()
    track: int = 0
    speed: float | None = None
    others: Sequence[Floats] = ()
    hit_car: bool = False


@dataclass(frozen=True)
class CarLook:
    """What the pictures need to know of a car.

    Attributes:
        body_radius: m.
        speed: of a car whose speed never varies, m/s.
        time_step: s.
        sensor_angles: directions of the rays, [R], rad counter-clockwise from the heading.
        sensor_range: m.
        body_size: length and width of a car that is a rectangle, m.
        sensor_mount: how far ahead of the middle of the car the rays begin, m.
    """

    body_radius: float
    speed: float
    time_step: float
    sensor_angles: Floats
    sensor_range: float
    body_size: tuple[float, float] | None = None
    sensor_mount: float = 0.0


class FollowPicture:
    """Draws one car from above, always in the middle and to the same scale, with a map of the whole track.

    Args:
        tracks: what snapshots count.
        car: how it looks.
        size: of the pictures, px.
    """

    def __init__(self, tracks: Sequence[Track], car: CarLook, size: Size = SIZE) -> None:
        """Prepares the tracks."""
        self.size, self._car = size, car
        self._grounds = [Ground.of(track) for track in tracks]
        self._canvas = PixelCanvas(*size)
        self._scale = size[1] / max(LEAST_VIEW, 2.4 * min(car.sensor_range, MOST_SEEN))
        self._figures, self._scale_bar, self._legend = _figures_panel(), self._scale_panel(), self._legend_panel()
        self._maps: dict[int, PixelCanvas] = {}

    def view(self, position: Floats) -> View:
        """What the picture shows of the track when the car is there, [2], m."""
        return View(Area(0, 0, *self.size), position, self._scale)

    def draw(self, car: CarSnapshot, message: Sequence[str] = (), caption: str = "") -> Picture:
        """The picture of a car, with lines of text on it if there are any, and one at its upper edge."""
        ground, view = self._grounds[car.track], self.view(car.pose[:2])
        self._canvas.clear(DARK.ground)
        draw_ground(self._canvas, view, ground, SCREEN, (car.next_gate,))
        self._draw_trail(view, car)
        self._draw_rays(view, car)
        look = self._car
        draw_others(self._canvas, view, car.others, look.body_radius, SCREEN, look.body_size)
        draw_car(
            self._canvas,
            view,
            car.pose,
            look.body_radius,
            SCREEN,
            body_size=look.body_size,
            steer=car.steer,
            collided=car.collided,
        )
        self._write_labels(view, ground, car)
        self._draw_map(ground, car)
        self._draw_figures(ground, car)
        self._draw_legends()
        if caption:
            self._draw_caption(caption)
        if message:
            self._draw_message(message)
        return self._canvas.picture()

    def _draw_rays(self, view: View, car: CarSnapshot) -> None:
        mount = self._car.sensor_mount
        ends = ray_ends(car.pose, car.readings * self._car.sensor_range, self._car.sensor_angles, mount)
        colours = [nearness_colour(reading) for reading in car.readings.tolist()]
        draw_rays(self._canvas, view, ray_origins(car.pose, mount), ends, colours, car.readings < 1, SCREEN)

    def _draw_trail(self, view: View, car: CarSnapshot) -> None:
        """A line through where the car was that fades towards the oldest."""
        way = np.stack([*car.trail, car.pose[:2]])
        pieces = np.stack([way[:-1], way[1:]], axis=1)
        shades = [blend(DARK.road, TRAIL, 0.15 + 0.6 * (shade + 1) / _TRAIL_SHADES) for shade in range(_TRAIL_SHADES)]
        shade_of = np.arange(len(pieces)) * _TRAIL_SHADES // max(1, len(pieces))
        draw_line(self._canvas, view, pieces, shade_of, shades, SCREEN.line.width(view))

    def _write_labels(self, view: View, ground: Ground, car: CarSnapshot) -> None:
        """The next gate's number beside it, and what became of the car above it."""
        ends = view.places(ground.gates[car.next_gate])
        outwards = (ends[0] - ends[1]) / max(1e-9, float(np.linalg.norm(ends[0] - ends[1])))
        for place in (ends[0] + 30 * outwards, ends[1] - 30 * outwards):
            self._write_about(place, f"gate {car.next_gate + 1}", DARK.next_gate)
        if car.collided:
            self._write_about(np.array(view.area.middle) - (0, 26), hit(car.hit_car), DARK.ink)

    def _write_about(self, place: Floats, text: str, colour: str) -> None:
        """A label with its middle at a place, [2], px, if all of it is in the picture and beside the upper panels."""
        reach = np.array([text_width(text, 13, bold=True) / 2, 7])
        ends = np.stack([place - reach, place + reach])
        width, height = self.size
        panels = Area(0, 0, *_FIGURES_SIZE), Area(width - _MAP_SIZE[0], 0, *_MAP_SIZE)
        is_clear = not any(
            (ends[1] > (panel.left, panel.top)).all() and (ends[0] < (panel.right, panel.bottom)).all()
            for panel in (each.inset(-3 * MARGIN) for each in panels)
        )
        if is_clear and Area(0, 0, width, height).holds(ends).all():
            self._canvas.text(place, text, 13, colour, bold=True, anchor="mm")

    def _draw_map(self, ground: Ground, car: CarSnapshot) -> None:
        panel = Area(self.size[0] - _MAP_SIZE[0] - MARGIN, MARGIN, *_MAP_SIZE)
        if car.track not in self._maps:
            self._maps[car.track] = _map_panel(ground)
        self._canvas.paste(self._maps[car.track], panel.left, panel.top)
        view = View.whole(ground.bounds, _map_area(panel))
        gate = view.places(ground.gates[car.next_gate].mean(axis=0))
        self._canvas.disc(gate, 4, None, Stroke(DARK.next_gate, 2))
        edge = Stroke(DARK.tyre, 1)
        for other in car.others:
            self._canvas.disc(view.places(other[:2]), 3.5, DARK.other_car, edge)
        self._canvas.disc(view.places(car.pose[:2]), 4.5, DARK.crash if car.collided else DARK.ink, edge)

    def _draw_figures(self, ground: Ground, car: CarSnapshot) -> None:
        """The table in the upper left corner."""
        gates = len(ground.gates)
        values = (
            f"{car.step:,}",
            f"{car.step * self._car.time_step:,.1f} s",
            f"{self._car.speed:.1f} m/s" if car.speed is None else f"{3.6 * car.speed:.0f} km/h",
            f"{car.gates_passed % gates} of {gates}",
            f"{car.gates_passed // gates}",
            f"{car.episode_return:,.0f}",
            car.action,
        )
        self._canvas.paste(self._figures, MARGIN, MARGIN)
        for index, value in enumerate(values):
            place = MARGIN + _FIGURES_SIZE[0] - 9, MARGIN + _FIRST_ROW + _ROW * index
            self._canvas.text(place, value, 13, DARK.ink, bold=True, anchor="rs")

    def _draw_legends(self) -> None:
        """At the bottom: how long 10 m are, and what the colours of the rays mean."""
        width, height = self.size
        top = height - MARGIN - _LEGEND_SIZE[1]
        self._canvas.paste(self._scale_bar, MARGIN, top)
        self._canvas.paste(self._legend, width - MARGIN - _LEGEND_SIZE[0], top)

    def _scale_panel(self) -> PixelCanvas:
        panel = _panel(round(10 * self._scale) + 18, _LEGEND_SIZE[1])
        bottom = _LEGEND_SIZE[1] - 8
        draw_scale_bar(panel, self.view(np.zeros(2)), 9, bottom, SCREEN, least=9.99 * self._scale, size=12)
        return panel

    def _legend_panel(self) -> PixelCanvas:
        width, height = _LEGEND_SIZE
        panel, left, right = _panel(width, height), 9, width - 9
        for column in range(left, right):
            panel.box(column, height - 12, 1.5, 5, nearness_colour((column - left) / (right - left)))
        panel.text((left, 16), "0", 12, DARK.ink)
        panel.text((right, 16), f"{self._car.sensor_range:g} m", 12, DARK.ink, anchor="rs")
        panel.text((width / 2 - 10, 16), "ray ends at", 12, DARK.faint, anchor="ms")
        return panel

    def _draw_caption(self, caption: str) -> None:
        """A line of text between the two upper panels."""
        room = self.size[0] - _FIGURES_SIZE[0] - _MAP_SIZE[0] - 6 * MARGIN
        text = fitted(caption, 13, room)
        width, middle = text_width(text, 13) + 18, (self.size[0] + _FIGURES_SIZE[0] - _MAP_SIZE[0]) / 2
        self._canvas.paste(_panel(round(width), 28), middle - width / 2, MARGIN)
        self._canvas.text((middle, MARGIN + 19), text, 13, DARK.ink, anchor="ms")

    def _draw_message(self, lines: Sequence[str]) -> None:
        """Lines of text below the middle, the first one large; a tab makes two columns."""
        rows = [[(part, 14.0 if index else 20.0) for part in line.split("\t")] for index, line in enumerate(lines)]
        widths = [text_width(part, size, bold=True) / (3 - len(row)) for row in rows for part, size in row]
        heights = [row[0][1] + 8 for row in rows]
        half, height = max(widths) + 30, sum(heights) + 20
        middle = self.size[0] / 2
        top = min(0.7 * self.size[1] - height / 2, self.size[1] - height - 6 * MARGIN)
        self._canvas.paste(_panel(round(2 * half), round(height)), middle - half, top)
        base = top + 8
        for row, room in zip(rows, heights, strict=True):
            base += room
            if len(row) == 1:
                self._canvas.text((middle, base - 4), *row[0], DARK.ink, bold=True, anchor="ms")
            else:
                self._canvas.text((middle - 10, base - 4), *row[0], DARK.ink, bold=True, anchor="rs")
                self._canvas.text((middle + 10, base - 4), *row[1], DARK.ink)


class FleetPicture:
    """Draws all cars of a batch on one whole track.

    Args:
        track: where they drive.
        body_radius: of each, m; they are drawn larger where that would be too small to see.
        size: of the pictures, px.
    """

    def __init__(self, track: Track, body_radius: float, size: Size = SIZE) -> None:
        """Draws the track."""
        ground = Ground.of(track)
        self._canvas, self._empty = PixelCanvas(*size), PixelCanvas(*size)
        self._view = View.whole(ground.bounds, Area(16, 44, size[0] - 32, size[1] - 60))
        self._radius = max(body_radius, 6.5 / self._view.scale)
        self._empty.clear(DARK.ground)
        draw_ground(self._empty, self._view, ground, SCREEN)

    def draw(self, poses: Floats, ended: NDArray[np.bool_], title: str) -> Picture:
        """The picture of cars at their poses [B, 3], those `ended` [B] on top in the colour of a crash."""
        self._canvas.paste(self._empty, 0, 0)
        shapes = self._view.places([placed(self._radius * _ARROW, pose) for pose in poses])
        colour_of = np.where(ended, -1, np.arange(len(poses)) % len(FLEET))
        for index in (*range(len(FLEET))[::-1], -1):
            if (colour_of == index).any():
                colour = DARK.crash if index < 0 else FLEET[index]
                self._canvas.area(shapes[colour_of == index], colour, Stroke(DARK.tyre, 1))
        self._canvas.paste(_panel(round(text_width(title, 13, bold=True)) + 18, 28), MARGIN, MARGIN)
        self._canvas.text((MARGIN + 9, MARGIN + 19), title, 13, DARK.ink, bold=True)
        return self._canvas.picture()


def _panel(width: int, height: int) -> PixelCanvas:
    panel = PixelCanvas(width, height)
    panel.clear(PANEL)
    return panel


def _figures_panel() -> PixelCanvas:
    panel = _panel(*_FIGURES_SIZE)
    for index, name in enumerate(("step", "time", "speed", "gates", "laps", "return", "action")):
        panel.text((9, _FIRST_ROW + _ROW * index), name, 13, DARK.faint)
    return panel


def _map_panel(ground: Ground) -> PixelCanvas:
    panel, area = _panel(*_MAP_SIZE), Area(0, 0, *_MAP_SIZE)
    draw_route(panel, View.whole(ground.bounds, _map_area(area)), ground, Stroke(DARK.faint, 2.6))
    panel.text((area.middle[0], area.bottom - 8), fitted(ground.name, 11, area.width - 12), 11, DARK.faint, anchor="ms")
    return panel


def _map_area(panel: Area) -> Area:
    """Where on its panel the map is, above the track's name."""
    return Area(panel.left + 8, panel.top + 8, panel.width - 16, panel.height - 32)


def hit(car: bool) -> str:
    """What ended a drive, in words."""
    return "hit a car" if car else "hit a wall"
