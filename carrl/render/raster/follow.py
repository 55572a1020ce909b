"""The picture that follows one car."""

from collections.abc import Sequence

import numpy as np
import pygame

from carrl.render.raster.brush import FINE, MARGIN, SIZE, draw_message, draw_panel, written
from carrl.render.raster.car import draw_car, draw_trail
from carrl.render.raster.ground import Ground
from carrl.render.raster.palette import CRASH, FAINT, GROUND, INK, NEXT_GATE, ROAD, TYRE, nearness_colour
from carrl.render.raster.projection import Floats, Projection, Size
from carrl.render.raster.scene import CarLook, Scene
from carrl.render.raster.track_map import TrackMap
from carrl.tracks.track import Track

LEAST_VIEW = 24.0
"""Height of what the picture shows, m; more where the rays reach farther."""
_MAP_SIZE = (150, 122)
_FIGURES_SIZE = (142, 135)


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
        self._grounds = [Ground(track) for track in tracks]
        self._maps: dict[int, TrackMap] = {}
        self._scale = size[1] / max(LEAST_VIEW, 2.4 * car.sensor_range)
        self._fine = pygame.Surface((size[0] * FINE, size[1] * FINE))
        self._picture = pygame.Surface(size)

    def draw(self, scene: Scene, message: Sequence[str] = ()) -> pygame.Surface:
        """The picture of a scene, with lines of text on it if there are any; the next call draws over it."""
        ground = self._grounds[scene.track]
        view = Projection(self._scale * FINE, scene.pose[:2], self._fine.get_size())
        self._fine.fill(GROUND)
        ground.draw(self._fine, view, scene.next_gate)
        draw_trail(self._fine, view, [*scene.trail, scene.pose[:2]])
        self._draw_rays(view, scene)
        draw_car(self._fine, view, scene, self._car.body_radius)
        pygame.transform.smoothscale(self._fine, self.size, self._picture)
        self._write_labels(ground, scene)
        self._draw_map(ground, scene)
        self._draw_figures(ground, scene)
        self._draw_legend()
        if message:
            draw_message(self._picture, message)
        return self._picture

    def _draw_rays(self, view: Projection, scene: Scene) -> None:
        angles = scene.pose[2] + self._car.sensor_angles
        reach = scene.readings[:, None] * self._car.sensor_range
        ends = view(scene.pose[:2] + reach * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
        middle = view(scene.pose[:2]).tolist()
        for end, reading in zip(ends.tolist(), scene.readings.tolist(), strict=True):
            colour = nearness_colour(reading)
            pygame.draw.line(self._fine, ROAD.lerp(colour, 0.6), middle, end, FINE)
            pygame.draw.circle(self._fine, colour, end, 4 * FINE, 0 if reading < 1 else FINE)

    def _write_labels(self, ground: Ground, scene: Scene) -> None:
        """The next gate's number beside it, and what became of the car above it."""
        view = Projection(self._scale, scene.pose[:2], self.size)
        gate = view(ground.gates[scene.next_gate])
        outwards = (gate[0] - gate[1]) / np.linalg.norm(gate[0] - gate[1])
        for place in (gate[0] + 26 * outwards, gate[1] - 26 * outwards):
            self._write_about(place, f"gate {scene.next_gate + 1}", NEXT_GATE)
        if scene.collided:
            self._write_about(np.array(self.size) / 2 - (0, 26), "hit a wall", INK)

    def _write_about(self, place: Floats, text: str, colour: pygame.Color) -> None:
        """A label with its middle at a place, [2], px, if all of it is in the picture and beside the upper panels."""
        label = written(text, 19, colour)
        area = label.get_rect(center=place.round().tolist())
        picture = self._picture.get_rect()
        panels = (pygame.Rect(picture.topleft, _FIGURES_SIZE), pygame.Rect((0, 0), _MAP_SIZE))
        panels[1].topright = picture.topright
        margin = 2 * MARGIN
        if picture.contains(area) and area.inflate(margin, margin).collidelist(panels) < 0:
            self._picture.blit(label, area)

    def _draw_map(self, ground: Ground, scene: Scene) -> None:
        track_map = self._maps.get(scene.track) or self._maps.setdefault(scene.track, TrackMap(ground, _MAP_SIZE))
        corner = (self.size[0] - _MAP_SIZE[0] - MARGIN, MARGIN)
        self._picture.blit(track_map.surface, corner)
        gate, car = (track_map.view(each) + corner for each in (ground.gates[scene.next_gate], scene.pose[:2]))
        pygame.draw.circle(self._picture, NEXT_GATE, gate.mean(axis=0).tolist(), 4, 2)
        pygame.draw.circle(self._picture, TYRE, car.tolist(), 5)
        pygame.draw.circle(self._picture, CRASH if scene.collided else INK, car.tolist(), 4)

    def _draw_figures(self, ground: Ground, scene: Scene) -> None:
        """The table in the upper left corner."""
        gates = len(ground.gates)
        rows = (
            ("step", f"{scene.step:,}"),
            ("time", f"{scene.step * self._car.time_step:,.1f} s"),
            ("speed", f"{self._car.speed:.1f} m/s"),
            ("gates", f"{scene.gates_passed % gates} of {gates}"),
            ("laps", f"{scene.gates_passed // gates}"),
            ("return", f"{scene.episode_return:,.0f}"),
            ("action", scene.action),
        )
        panel = pygame.Rect((MARGIN, MARGIN), _FIGURES_SIZE)
        draw_panel(self._picture, panel)
        for index, (name, value) in enumerate(rows):
            top = panel.top + 8 + 17 * index
            figure = written(value, 19, INK)
            self._picture.blit(written(name, 19, FAINT), (panel.left + 9, top))
            self._picture.blit(figure, (panel.right - 9 - figure.get_width(), top))

    def _draw_legend(self) -> None:
        """At the bottom: how long 10 m are, and what the colours of the rays mean."""
        width, height = self.size
        bottom, length = height - 18, 10 * self._scale
        draw_panel(self._picture, pygame.Rect(MARGIN, bottom - 22, round(length) + 18, 32))
        left, right = MARGIN + 9, MARGIN + 9 + length
        pygame.draw.line(self._picture, INK, (left, bottom), (right, bottom), 2)
        for end in (left, right):
            pygame.draw.line(self._picture, INK, (end, bottom - 4), (end, bottom + 4), 2)
        self._picture.blit(written("10 m", 18, INK), (left + 8, bottom - 17))
        draw_panel(self._picture, pygame.Rect(width - MARGIN - _MAP_SIZE[0], bottom - 22, _MAP_SIZE[0], 32))
        left, right = width - MARGIN - _MAP_SIZE[0] + 9, width - MARGIN - 9
        for column in range(left, right):
            colour = nearness_colour((column - left) / (right - left))
            pygame.draw.line(self._picture, colour, (column, bottom - 2), (column, bottom + 3))
        reach, ray = written(f"{self._car.sensor_range:g} m", 18, INK), written("ray ends at", 18, FAINT)
        self._picture.blit(written("0", 18, INK), (left, bottom - 17))
        self._picture.blit(reach, (right - reach.get_width(), bottom - 17))
        self._picture.blit(ray, ray.get_rect(midtop=((left + right) / 2 - 10, bottom - 17)))
