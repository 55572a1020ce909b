"""A car seen from above, and its trail.

Shapes: `T` time steps.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pygame

from carrl.render.raster.brush import FINE
from carrl.render.raster.palette import CAR, CRASH, ROAD, TRAIL, TYRE
from carrl.render.raster.projection import Floats, Projection, placed
from carrl.render.raster.scene import Scene

# In body radii, nose to +x.
_HULL = np.array([[-0.92, -0.4], [-0.92, 0.4], [0.45, 0.42], [0.95, 0.2], [0.95, -0.2], [0.45, -0.42]])
_SCREEN = np.array([[-0.05, -0.3], [-0.05, 0.3], [0.3, 0.24], [0.3, -0.24]])
_TYRE = np.array([[-0.22, -0.11], [-0.22, 0.11], [0.22, 0.11], [0.22, -0.11]])
_AXLES = ((-0.55, -0.48), (-0.55, 0.48), (0.5, -0.48), (0.5, 0.48))
_WHEEL_ANGLE = 0.45


def draw_trail(surface: pygame.Surface, view: Projection, trail: Sequence[Floats]) -> None:
    """A line through the positions [T, 2], m, that fades towards the oldest."""
    points = view(np.stack(trail)).tolist()
    for index, (begin, end) in enumerate(pairwise(points)):
        pygame.draw.line(surface, ROAD.lerp(TRAIL, 0.15 + 0.6 * index / len(points)), begin, end, 2 * FINE)


def draw_car(surface: pygame.Surface, view: Projection, scene: Scene, body_radius: float) -> None:
    """The car with its front wheels turned, in the disc that must not touch a wall."""
    radius = max(body_radius, 6 * FINE / view.scale)
    middle, colour = view(scene.pose[:2]).tolist(), CRASH if scene.collided else CAR
    pygame.draw.circle(surface, ROAD.lerp(colour, 0.5), middle, radius * view.scale, FINE)
    for x, y in _AXLES:
        angle = _WHEEL_ANGLE * scene.steer if x > 0 else 0.0
        tyre = placed(_TYRE, np.array([x, y, angle]))
        pygame.draw.polygon(surface, TYRE, view(placed(radius * tyre, scene.pose)).tolist())
    pygame.draw.polygon(surface, colour, view(placed(radius * _HULL, scene.pose)).tolist())
    pygame.draw.polygon(surface, TYRE, view(placed(radius * _SCREEN, scene.pose)).tolist())
