"""Pictures of cars on the road, drawn with pygame: one that follows a car, and one of all cars on the whole track.

Both are drawn on surfaces in memory; only `Window` needs a display. Everything is drawn twice as large and then
shrunk, which smooths all edges.

Shapes: `P` points of the centreline, `G` gates, `B` cars, `R` rays, `T` time steps, `K` any points. Positions on the
track are in metres, y upwards; positions in a picture are in pixels, y downwards.
"""

import os
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from carrl.errors import ConfigError
from carrl.sim.bridges import on_stretch
from carrl.sim.track import Track
from carrl.sim.vehicle import Action

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
try:
    with warnings.catch_warnings():
        # pygame 2.6 imports setuptools' pkg_resources where that exists, which then warns of its own end.
        warnings.filterwarnings("ignore", "pkg_resources is deprecated")
        warnings.filterwarnings("ignore", r"Deprecated call to `pkg_resources", DeprecationWarning)
        import pygame
        import pygame.font
except ImportError as error:
    raise ConfigError("drawing needs pygame, which is not installed; pip install 'carrl[render]'") from error

Floats = NDArray[np.floating]
Size = tuple[int, int]

SIZE: Size = (640, 480)
"""Of a picture, unless another is asked for, px."""
LEAST_VIEW = 24.0
"""Height of what the picture that follows a car shows, m; more where the rays reach farther."""
FINE = 2
"""How many times larger everything is drawn before it is shrunk."""

GROUND, ROAD, WALL, GATE = (pygame.Color(name) for name in ("#1d2429", "#414b53", "#e8eaec", "#77838c"))
INK, FAINT, PANEL = (pygame.Color(name) for name in ("#f4f5f6", "#a9b3ba", "#12171bf0"))
NEXT_GATE, CAR, TYRE, TRAIL = (pygame.Color(name) for name in ("#f0e442", "#f0e442", "#0b0e10", "#56b4e9"))
NEAR, MIDDLE, FAR = (pygame.Color(name) for name in ("#d55e00", "#f0e442", "#56b4e9"))
CRASH = pygame.Color("#d55e00")
FLEET = tuple(pygame.Color(name) for name in ("#f0e442", "#56b4e9", "#e69f00", "#cc79a7", "#00c794"))
"""Colours of the cars in the picture of all, in turn; these and the others are Okabe and Ito's (2008), some lighter."""

# The car seen from above, in body radii, nose to +x.
_HULL = np.array([[-0.92, -0.4], [-0.92, 0.4], [0.45, 0.42], [0.95, 0.2], [0.95, -0.2], [0.45, -0.42]])
_SCREEN = np.array([[-0.05, -0.3], [-0.05, 0.3], [0.3, 0.24], [0.3, -0.24]])
_TYRE = np.array([[-0.22, -0.11], [-0.22, 0.11], [0.22, 0.11], [0.22, -0.11]])
_AXLES = ((-0.55, -0.48), (-0.55, 0.48), (0.5, -0.48), (0.5, 0.48))
_ARROW = np.array([[-0.8, -0.65], [-0.45, 0.0], [-0.8, 0.65], [1.1, 0.0]])
_WHEEL_ANGLE = {Action.FORWARD: 0.0, Action.LEFT: 0.45, Action.RIGHT: -0.45}
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")  # one of them is set wherever a window can be seen
_CHEQUER = 0.5  # side of a square of the start line, m
_MAP_SIZE = (150, 122)
_MARGIN = 8


@dataclass(frozen=True)
class Scene:
    """A car at one moment of its episode.

    Attributes:
        pose: x m, y m, heading rad counter-clockwise from +x, [3].
        readings: distance along each ray / range, [R], in 0..1.
        next_gate: index of the gate that counts next.
        gates_passed: since the start.
        step: steps since the start.
        last_action: a value of `Action`.
        episode_return: sum of the rewards since the start.
        collided: the car touched a wall in the last step.
        trail: where the car was before, oldest first, [T, 2], m.
        track: index of what it drives on.
    """

    pose: Floats
    readings: Floats
    next_gate: int
    gates_passed: int
    step: int
    last_action: int
    episode_return: float
    collided: bool = False
    trail: Sequence[Floats] = ()
    track: int = 0


@dataclass(frozen=True)
class CarLook:
    """What the pictures need to know of a car.

    Attributes:
        body_radius: m.
        speed: m/s.
        time_step: s.
        sensor_angles: directions of the rays, [R], rad counter-clockwise from the heading.
        sensor_range: m.
    """

    body_radius: float
    speed: float
    time_step: float
    sensor_angles: Floats
    sensor_range: float


class Window:
    """A window on the display that shows pictures at a steady pace.

    Raises:
        ConfigError: there is no display.
    """

    def __init__(self, size: Size, title: str) -> None:
        """Opens it."""
        try:
            # Without a display SDL 2.28 draws where nobody can see it, instead of failing.
            if sys.platform == "linux" and not any(name in os.environ for name in _DISPLAYS):
                raise pygame.error("no display was found")
            pygame.display.init()
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            pygame.display.quit()
            raise ConfigError(
                f"no window can be opened: {error}; go where there is a display (render_mode='rgb_array' needs none)"
            ) from error
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()

    def show(self, picture: pygame.Surface, fps: float) -> None:
        """Shows the picture, no sooner than 1 / fps seconds after the one before."""
        self._screen.blit(picture, (0, 0))
        pygame.event.pump()
        self._clock.tick(fps)
        pygame.display.flip()

    def close(self) -> None:
        """Closes it; twice does no harm."""
        pygame.display.quit()


def pixels(picture: pygame.Surface) -> NDArray[np.uint8]:
    """A copy of a picture, [height, width, 3], RGB."""
    width, height = picture.get_size()
    return np.frombuffer(pygame.image.tobytes(picture, "RGB"), np.uint8).reshape(height, width, 3).copy()


class FollowPicture:
    """Draws one car from above, always in the middle and to the same scale, with a map of the whole track.

    Args:
        tracks: what scenes count.
        car: how it looks.
        size: of the pictures, px.
    """

    def __init__(self, tracks: Sequence[Track], car: CarLook, size: Size = SIZE) -> None:
        """Prepares the tracks."""
        self.size, self._car = size, car
        self._grounds = [_Ground(track) for track in tracks]
        self._maps: dict[int, _TrackMap] = {}
        self._scale = size[1] / max(LEAST_VIEW, 2.4 * car.sensor_range)
        self._fine = pygame.Surface((size[0] * FINE, size[1] * FINE))
        self._picture = pygame.Surface(size)

    def draw(self, scene: Scene, message: Sequence[str] = ()) -> pygame.Surface:
        """The picture of a scene, with lines of text on it if there are any; the next call draws over it."""
        ground = self._grounds[scene.track]
        view = _Projection(self._scale * FINE, scene.pose[:2], self._fine.get_size())
        self._fine.fill(GROUND)
        ground.draw(self._fine, view, scene.next_gate)
        _draw_trail(self._fine, view, [*scene.trail, scene.pose[:2]])
        self._draw_rays(view, scene)
        _draw_car(self._fine, view, scene, self._car.body_radius)
        pygame.transform.smoothscale(self._fine, self.size, self._picture)
        self._write_labels(ground, scene)
        self._draw_map(ground, scene)
        self._draw_figures(ground, scene)
        self._draw_legend()
        if message:
            _draw_message(self._picture, message)
        return self._picture

    def _draw_rays(self, view: "_Projection", scene: Scene) -> None:
        angles = scene.pose[2] + self._car.sensor_angles
        reach = scene.readings[:, None] * self._car.sensor_range
        ends = view(scene.pose[:2] + reach * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
        middle = view(scene.pose[:2]).tolist()
        for end, reading in zip(ends.tolist(), scene.readings.tolist(), strict=True):
            colour = _nearness_colour(reading)
            pygame.draw.line(self._fine, ROAD.lerp(colour, 0.6), middle, end, FINE)
            pygame.draw.circle(self._fine, colour, end, 4 * FINE, 0 if reading < 1 else FINE)

    def _write_labels(self, ground: "_Ground", scene: Scene) -> None:
        """The next gate's number beside it, and what became of the car above it."""
        view = _Projection(self._scale, scene.pose[:2], self.size)
        gate = view(ground.gates[scene.next_gate])
        outwards = (gate[0] - gate[1]) / np.linalg.norm(gate[0] - gate[1])
        for place in (gate[0] + 26 * outwards, gate[1] - 26 * outwards):
            self._write_about(place, f"gate {scene.next_gate + 1}", NEXT_GATE)
        if scene.collided:
            self._write_about(np.array(self.size) / 2 - (0, 26), "hit a wall", INK)

    def _write_about(self, place: Floats, text: str, colour: pygame.Color) -> None:
        """A label with its middle at a place, [2], px, if all of it is in the picture."""
        label = _text(text, 19, colour)
        area = label.get_rect(center=place.round().tolist())
        if self._picture.get_rect().contains(area):
            self._picture.blit(label, area)

    def _draw_map(self, ground: "_Ground", scene: Scene) -> None:
        track_map = self._maps.get(scene.track) or self._maps.setdefault(scene.track, _TrackMap(ground, _MAP_SIZE))
        corner = (self.size[0] - _MAP_SIZE[0] - _MARGIN, _MARGIN)
        self._picture.blit(track_map.surface, corner)
        gate, car = (track_map.view(each) + corner for each in (ground.gates[scene.next_gate], scene.pose[:2]))
        pygame.draw.circle(self._picture, NEXT_GATE, gate.mean(axis=0).tolist(), 4, 2)
        pygame.draw.circle(self._picture, TYRE, car.tolist(), 5)
        pygame.draw.circle(self._picture, CRASH if scene.collided else INK, car.tolist(), 4)

    def _draw_figures(self, ground: "_Ground", scene: Scene) -> None:
        """The table in the upper left corner."""
        gates = len(ground.gates)
        rows = (
            ("step", f"{scene.step:,}"),
            ("time", f"{scene.step * self._car.time_step:,.1f} s"),
            ("speed", f"{self._car.speed:.1f} m/s"),
            ("gates", f"{scene.gates_passed % gates} of {gates}"),
            ("laps", f"{scene.gates_passed // gates}"),
            ("return", f"{scene.episode_return:,.0f}"),
            ("action", Action(scene.last_action).name.lower()),
        )
        panel = pygame.Rect(_MARGIN, _MARGIN, 142, 16 + 17 * len(rows))
        _draw_panel(self._picture, panel)
        for index, (name, value) in enumerate(rows):
            top = panel.top + 8 + 17 * index
            figure = _text(value, 19, INK)
            self._picture.blit(_text(name, 19, FAINT), (panel.left + 9, top))
            self._picture.blit(figure, (panel.right - 9 - figure.get_width(), top))

    def _draw_legend(self) -> None:
        """At the bottom: how long 10 m are, and what the colours of the rays mean."""
        width, height = self.size
        bottom, length = height - 18, 10 * self._scale
        _draw_panel(self._picture, pygame.Rect(_MARGIN, bottom - 22, round(length) + 18, 32))
        left, right = _MARGIN + 9, _MARGIN + 9 + length
        pygame.draw.line(self._picture, INK, (left, bottom), (right, bottom), 2)
        for end in (left, right):
            pygame.draw.line(self._picture, INK, (end, bottom - 4), (end, bottom + 4), 2)
        self._picture.blit(_text("10 m", 18, INK), (left + 8, bottom - 17))
        _draw_panel(self._picture, pygame.Rect(width - _MARGIN - _MAP_SIZE[0], bottom - 22, _MAP_SIZE[0], 32))
        left, right = width - _MARGIN - _MAP_SIZE[0] + 9, width - _MARGIN - 9
        for column in range(left, right):
            colour = _nearness_colour((column - left) / (right - left))
            pygame.draw.line(self._picture, colour, (column, bottom - 2), (column, bottom + 3))
        reach, ray = _text(f"{self._car.sensor_range:g} m", 18, INK), _text("ray ends at", 18, FAINT)
        self._picture.blit(_text("0", 18, INK), (left, bottom - 17))
        self._picture.blit(reach, (right - reach.get_width(), bottom - 17))
        self._picture.blit(ray, ray.get_rect(midtop=((left + right) / 2 - 10, bottom - 17)))


class FleetPicture:
    """Draws all cars of a batch on one whole track.

    Args:
        track: where they drive.
        body_radius: of each, m; they are drawn larger where that would be too small to see.
        size: of the pictures, px.
    """

    def __init__(self, track: Track, body_radius: float, size: Size = SIZE) -> None:
        """Draws the track."""
        self._map, self._radius = _TrackMap(_Ground(track), size, panel=False), body_radius
        self._picture = pygame.Surface(size)

    def draw(self, poses: Floats, ended: NDArray[np.bool_], title: str) -> pygame.Surface:
        """The picture of cars at their poses [B, 3], those `ended` [B] in the colour of a crash, the first on top."""
        self._picture.blit(self._map.surface, (0, 0))
        view = self._map.view
        shape = _ARROW * max(self._radius, 6.5 / view.scale)
        for car in range(len(poses))[::-1]:
            colour = CRASH if ended[car] else FLEET[car % len(FLEET)]
            outline = view(_placed(shape, poses[car])).tolist()
            pygame.draw.polygon(self._picture, colour, outline)
            pygame.draw.aalines(self._picture, TYRE, True, outline)
        _draw_panel(self._picture, pygame.Rect(_MARGIN, _MARGIN, _text(title, 20, INK).get_width() + 18, 28))
        self._picture.blit(_text(title, 20, INK), (_MARGIN + 9, _MARGIN + 8))
        return self._picture


@dataclass(frozen=True)
class _Projection:
    """From the track to a picture of this size with one position in its middle."""

    scale: float  # px per m
    middle: Floats  # [2], m
    size: Size  # px

    def __call__(self, points: Floats) -> Floats:
        """Positions [..., 2], m, in the picture, [..., 2], px."""
        return np.asarray((points - self.middle) * (self.scale, -self.scale) + np.array(self.size) / 2)

    def sees(self, low: Floats, high: Floats) -> NDArray[np.bool_]:
        """Which of the rectangles between these corners, [K, 2], m, may be in the picture, [K]."""
        reach = np.array(self.size) / 2 / self.scale
        return np.all((high >= self.middle - reach) & (low <= self.middle + reach), axis=-1)


@dataclass
class _Ground:
    """A track, cut into the pieces that are drawn: at bridges, those that are over come last."""

    track: Track
    road: Floats = field(init=False)
    """From each point of the centreline to the next: left wall there and back along the right one, [P, 4, 2], m."""
    gates: Floats = field(init=False)
    """Left and right end, [G, 2, 2], m."""

    def __post_init__(self) -> None:
        left, right = (side.numpy().astype(np.float64) for side in (self.track.left_wall, self.track.right_wall))
        self.road = np.stack([left, np.roll(left, -1, 0), np.roll(right, -1, 0), right], axis=1)
        self.gates = self.track.gates.numpy().astype(np.float64)
        self.middle = self.track.centreline.numpy().astype(np.float64)
        steps = np.linalg.norm(np.roll(self.middle, -1, 0) - self.middle, axis=1)
        self._road_is_over = self._is_over(steps.cumsum() - steps / 2)
        self._gate_is_over = self._is_over(self.track.gate_stations.numpy())
        self._low, self._high = self.road.min(axis=1), self.road.max(axis=1)

    def draw(self, surface: pygame.Surface, view: _Projection, next_gate: int | None) -> None:
        """Draws what is in view."""
        road = view.sees(self._low, self._high)
        gates = view.sees(self.gates.min(axis=1), self.gates.max(axis=1))
        for over in (False, True):
            pieces = view(self.road[road & (self._road_is_over == over)]).tolist()
            for piece in pieces:
                pygame.draw.polygon(surface, ROAD, piece)
            for gate in np.flatnonzero(gates & (self._gate_is_over == over)):
                self._draw_gate(surface, view, int(gate), next_gate)
            width = max(2, round(0.2 * view.scale))
            for left, left_end, right_end, right in pieces:
                for begin, end in ((left, left_end), (right, right_end)):
                    pygame.draw.line(surface, WALL, begin, end, width)
                    pygame.draw.circle(surface, WALL, end, (width - 1) / 2)

    def _draw_gate(self, surface: pygame.Surface, view: _Projection, gate: int, next_gate: int | None) -> None:
        """The last gate is the start line."""
        if gate == len(self.gates) - 1:
            _draw_chequers(surface, view, self.gates[gate])
        elif gate != next_gate:
            _draw_across(surface, view(self.gates[gate]), GATE, max(2, round(0.12 * view.scale)))
        if gate == next_gate:
            _draw_across(surface, view(self.gates[gate]), NEXT_GATE, max(3, round(0.25 * view.scale)))

    def _is_over(self, stations: Floats) -> NDArray[np.bool_]:
        """Whether stations [K], m, lie on the upper road of a bridge, [K]."""
        over = np.zeros(len(stations), dtype=bool)
        for bridge in self.track.bridges:
            over |= on_stretch(stations, bridge.over, self.track.length)
        return over


class _TrackMap:
    """A picture of a whole track: `surface`, and where things are on it, `view`."""

    def __init__(self, ground: _Ground, size: Size, panel: bool = True) -> None:
        """Draws it; a panel has the track's name below and stands in a corner of another picture."""
        head, foot, rim = (6, 20, 6) if panel else (44, 16, 16)
        corners = ground.road.reshape(-1, 2)
        low, high = corners.min(axis=0), corners.max(axis=0)
        room = np.array(size) - (2 * rim, head + foot)
        scale = float((room / (high - low)).min())
        middle = (low + high) / 2 + (0, (head - foot) / 2 / scale)
        self.view = _Projection(scale, middle, size)
        large = pygame.Surface((size[0] * FINE, size[1] * FINE), pygame.SRCALPHA)
        if not panel:
            large.fill(GROUND)
        else:
            pygame.draw.rect(large, PANEL, large.get_rect(), border_radius=6 * FINE)
        view = _Projection(scale * FINE, middle, large.get_size())
        line = view(ground.middle).tolist()
        for colour, width in ((WALL, 3.2), (ROAD, 1.6)) if not panel else ((FAINT, 2.6),):
            _draw_ring(large, colour, line, round(width * FINE))
        if not panel:
            ground.draw(large, view, None)
        start = view(ground.gates[-1])
        across = (start[0] - start[1]) / np.linalg.norm(start[0] - start[1])
        if np.linalg.norm(start[0] - start[1]) < 12 * FINE:  # too short to be seen otherwise
            ends = start.mean(axis=0) + 6 * FINE * np.stack([across, -across])
            _draw_across(large, ends, INK, 2 * FINE)
        self.surface = pygame.transform.smoothscale(large, size)
        if panel:
            name = _text(ground.track.name[:24], 17, FAINT)
            self.surface.blit(name, name.get_rect(midbottom=(size[0] / 2, size[1] - 4)))


def _nearness_colour(reading: float) -> pygame.Color:
    """Of a ray that reads this, 0..1."""
    return NEAR.lerp(MIDDLE, min(1, 2 * reading)) if reading < 0.5 else MIDDLE.lerp(FAR, min(1, 2 * reading - 1))


def _placed(shape: Floats, pose: Floats) -> Floats:
    """A shape with its nose to +x, [K, 2], m, at a pose [3]."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return np.asarray(shape @ np.array([[cosine, sine], [-sine, cosine]]) + pose[:2])


def _draw_across(surface: pygame.Surface, ends: Floats, colour: pygame.Color, width: int) -> None:
    """A line between two ends [2, 2], px."""
    pygame.draw.line(surface, colour, ends[0].tolist(), ends[1].tolist(), width)


def _draw_ring(surface: pygame.Surface, colour: pygame.Color, line: list[list[float]], width: int) -> None:
    """A closed line with round corners."""
    pygame.draw.lines(surface, colour, True, line, width)
    for point in line:
        pygame.draw.circle(surface, colour, point, width / 2)


def _draw_chequers(surface: pygame.Surface, view: _Projection, gate: Floats) -> None:
    """Two rows of black and white squares along a gate [2, 2], m."""
    count = max(2, round(float(np.linalg.norm(gate[1] - gate[0])) / _CHEQUER))
    across = (gate[1] - gate[0]) / count
    forward = np.array([-across[1], across[0]])
    for row in (-1, 0):
        for column in range(count):
            corner = gate[0] + column * across + row * forward
            square = np.stack([corner, corner + across, corner + across + forward, corner + forward])
            pygame.draw.polygon(surface, INK if (row + column) % 2 else TYRE, view(square).tolist())


def _draw_trail(surface: pygame.Surface, view: _Projection, trail: Sequence[Floats]) -> None:
    """A line through the positions [T, 2], m, that fades towards the oldest."""
    points = view(np.stack(trail)).tolist()
    for index, (begin, end) in enumerate(pairwise(points)):
        pygame.draw.line(surface, ROAD.lerp(TRAIL, 0.15 + 0.6 * index / len(points)), begin, end, 2 * FINE)


def _draw_car(surface: pygame.Surface, view: _Projection, scene: Scene, body_radius: float) -> None:
    """The car with its front wheels turned, in the disc that must not touch a wall."""
    radius = max(body_radius, 6 * FINE / view.scale)
    middle, colour = view(scene.pose[:2]).tolist(), CRASH if scene.collided else CAR
    pygame.draw.circle(surface, ROAD.lerp(colour, 0.5), middle, radius * view.scale, FINE)
    for x, y in _AXLES:
        angle = _WHEEL_ANGLE[Action(scene.last_action)] if x > 0 else 0.0
        tyre = _placed(_TYRE, np.array([x, y, angle]))
        pygame.draw.polygon(surface, TYRE, view(_placed(radius * tyre, scene.pose)).tolist())
    pygame.draw.polygon(surface, colour, view(_placed(radius * _HULL, scene.pose)).tolist())
    pygame.draw.polygon(surface, TYRE, view(_placed(radius * _SCREEN, scene.pose)).tolist())


def _draw_panel(surface: pygame.Surface, place: pygame.Rect) -> None:
    surface.blit(_panel(place.size), place)


@lru_cache(maxsize=16)
def _panel(size: Size) -> pygame.Surface:
    """A dark rectangle with round corners that lets something through."""
    panel = pygame.Surface(size, pygame.SRCALPHA)
    pygame.draw.rect(panel, PANEL, panel.get_rect(), border_radius=6)
    return panel


def _draw_message(surface: pygame.Surface, lines: Sequence[str]) -> None:
    """Lines of text below the middle, the first one large; a tab makes two columns."""
    rows = [[_text(part, 20 if index else 30, INK) for part in line.split("\t")] for index, line in enumerate(lines)]
    half = max(max(part.get_width() / (3 - len(row)) for part in row) for row in rows) + 30
    place = pygame.Rect(0, 0, round(2 * half), sum(row[0].get_height() + 8 for row in rows) + 24)
    place.center = surface.get_width() // 2, round(0.7 * surface.get_height())
    _draw_panel(surface, place)
    top = place.top + 16
    for row in rows:
        if len(row) == 1:
            surface.blit(row[0], row[0].get_rect(midtop=(place.centerx, top)))
        else:
            surface.blit(row[0], row[0].get_rect(topright=(place.centerx - 10, top)))
            surface.blit(row[1], (place.centerx + 10, top))
        top += row[0].get_height() + 8


def _text(text: str, height: int, colour: pygame.Color) -> pygame.Surface:
    return _written(text, height, (colour.r, colour.g, colour.b))


@lru_cache(maxsize=256)
def _written(text: str, height: int, colour: tuple[int, int, int]) -> pygame.Surface:
    pygame.font.init()
    return pygame.font.Font(None, height).render(text, True, colour)  # A kept font would not outlive pygame.quit().
