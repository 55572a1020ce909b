"""A whole track on one picture."""

import numpy as np
import pygame

from carrl.render.raster.brush import FINE, draw_across, draw_ring, written
from carrl.render.raster.ground import Ground
from carrl.render.raster.palette import FAINT, GROUND, INK, PANEL, ROAD, WALL
from carrl.render.raster.projection import Projection, Size


class TrackMap:
    """A picture of a whole track: `surface`, and where things are on it, `view`."""

    def __init__(self, ground: Ground, size: Size, panel: bool = True) -> None:
        """Draws it; a panel has the track's name below and stands in a corner of another picture."""
        head, foot, rim = (6, 20, 6) if panel else (44, 16, 16)
        corners = ground.road.reshape(-1, 2)
        low, high = corners.min(axis=0), corners.max(axis=0)
        room = np.array(size) - (2 * rim, head + foot)
        scale = float((room / (high - low)).min())
        middle = (low + high) / 2 + (0, (head - foot) / 2 / scale)
        self.view = Projection(scale, middle, size)
        large = pygame.Surface((size[0] * FINE, size[1] * FINE), pygame.SRCALPHA)
        if not panel:
            large.fill(GROUND)
        else:
            pygame.draw.rect(large, PANEL, large.get_rect(), border_radius=6 * FINE)
        view = Projection(scale * FINE, middle, large.get_size())
        line = view(ground.middle).tolist()
        for colour, width in ((WALL, 3.2), (ROAD, 1.6)) if not panel else ((FAINT, 2.6),):
            draw_ring(large, colour, line, round(width * FINE))
        if not panel:
            ground.draw(large, view, None)
        start = view(ground.gates[-1])
        across = (start[0] - start[1]) / np.linalg.norm(start[0] - start[1])
        if np.linalg.norm(start[0] - start[1]) < 12 * FINE:  # too short to be seen otherwise
            ends = start.mean(axis=0) + 6 * FINE * np.stack([across, -across])
            draw_across(large, ends, INK, 2 * FINE)
        self.surface = pygame.transform.smoothscale(large, size)
        if panel:
            name = written(ground.track.name[:24], 17, FAINT)
            self.surface.blit(name, name.get_rect(midbottom=(size[0] / 2, size[1] - 4)))
