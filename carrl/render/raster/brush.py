"""How things are drawn on a surface: its size, lines, panels and text."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pygame
import pygame.font
from numpy.typing import NDArray

from carrl.render.raster.palette import INK, PANEL
from carrl.render.raster.projection import Floats, Size

SIZE: Size = (640, 480)
"""Of a picture, unless another is asked for, px."""
FINE = 2
"""How many times larger what has slanting edges is drawn before it is shrunk, which smooths them."""
MARGIN = 8
"""Between a panel and the rim of its picture, px."""


def pixels(picture: pygame.Surface) -> NDArray[np.uint8]:
    """A copy of a picture, [height, width, 3], RGB."""
    width, height = picture.get_size()
    return np.frombuffer(pygame.image.tobytes(picture, "RGB"), np.uint8).reshape(height, width, 3).copy()


def draw_across(surface: pygame.Surface, ends: Floats, colour: pygame.Color, width: int) -> None:
    """A line between two ends [2, 2], px."""
    pygame.draw.line(surface, colour, ends[0].tolist(), ends[1].tolist(), width)


def draw_ring(surface: pygame.Surface, colour: pygame.Color, line: list[list[float]], width: int) -> None:
    """A closed line with round corners."""
    pygame.draw.lines(surface, colour, True, line, width)
    for point in line:
        pygame.draw.circle(surface, colour, point, width / 2)


def draw_panel(surface: pygame.Surface, place: pygame.Rect) -> None:
    """A dark rectangle with round corners that lets something through."""
    surface.blit(_panel(place.size), place)


@lru_cache(maxsize=16)
def _panel(size: Size) -> pygame.Surface:
    panel = pygame.Surface(size, pygame.SRCALPHA)
    pygame.draw.rect(panel, PANEL, panel.get_rect(), border_radius=6)
    return panel


def written(text: str, height: int, colour: pygame.Color) -> pygame.Surface:
    """A line of text, its letters of this height, px, on nothing."""
    return _letters(text, height, (colour.r, colour.g, colour.b))


@lru_cache(maxsize=256)
def _letters(text: str, height: int, colour: tuple[int, int, int]) -> pygame.Surface:
    pygame.font.init()
    return pygame.font.Font(None, height).render(text, True, colour)  # A kept font would not outlive pygame.quit().


def draw_message(surface: pygame.Surface, lines: Sequence[str]) -> None:
    """Lines of text below the middle, the first one large; a tab makes two columns."""
    rows = [[written(part, 20 if index else 30, INK) for part in line.split("\t")] for index, line in enumerate(lines)]
    half = max(max(part.get_width() / (3 - len(row)) for part in row) for row in rows) + 30
    place = pygame.Rect(0, 0, round(2 * half), sum(row[0].get_height() + 8 for row in rows) + 24)
    place.center = surface.get_width() // 2, round(0.7 * surface.get_height())
    draw_panel(surface, place)
    top = place.top + 16
    for row in rows:
        if len(row) == 1:
            surface.blit(row[0], row[0].get_rect(midtop=(place.centerx, top)))
        else:
            surface.blit(row[0], row[0].get_rect(topright=(place.centerx - 10, top)))
            surface.blit(row[1], (place.centerx + 10, top))
        top += row[0].get_height() + 8
