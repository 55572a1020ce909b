"""The picture of all cars of a batch.

Shapes: `B` cars.
"""

import numpy as np
import pygame
from numpy.typing import NDArray

from carrl.render.raster.brush import MARGIN, SIZE, draw_panel, written
from carrl.render.raster.ground import Ground
from carrl.render.raster.palette import CRASH, FLEET, INK, TYRE
from carrl.render.raster.projection import Floats, Size, placed
from carrl.render.raster.track_map import TrackMap
from carrl.tracks.track import Track

_ARROW = np.array([[-0.8, -0.65], [-0.45, 0.0], [-0.8, 0.65], [1.1, 0.0]])  # a car, in body radii, nose to +x


class FleetPicture:
    """Draws all cars of a batch on one whole track.

    Args:
        track: where they drive.
        body_radius: of each, m; they are drawn larger where that would be too small to see.
        size: of the pictures, px.
    """

    def __init__(self, track: Track, body_radius: float, size: Size = SIZE) -> None:
        """Draws the track."""
        self._map, self._radius = TrackMap(Ground(track), size, panel=False), body_radius
        self._picture = pygame.Surface(size)

    def draw(self, poses: Floats, ended: NDArray[np.bool_], title: str) -> pygame.Surface:
        """The picture of cars at their poses [B, 3], those `ended` [B] in the colour of a crash, the first on top."""
        self._picture.blit(self._map.surface, (0, 0))
        view = self._map.view
        shape = _ARROW * max(self._radius, 6.5 / view.scale)
        for car in range(len(poses))[::-1]:
            colour = CRASH if ended[car] else FLEET[car % len(FLEET)]
            outline = view(placed(shape, poses[car])).tolist()
            pygame.draw.polygon(self._picture, colour, outline)
            pygame.draw.aalines(self._picture, TYRE, True, outline)
        draw_panel(self._picture, pygame.Rect(MARGIN, MARGIN, written(title, 20, INK).get_width() + 18, 28))
        self._picture.blit(written(title, 20, INK), (MARGIN + 9, MARGIN + 8))
        return self._picture
