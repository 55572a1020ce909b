"""The colours of the pictures: greys, and those of Okabe and Ito (2008), some of them lighter."""

import pygame

GROUND, ROAD, WALL, GATE = (pygame.Color(name) for name in ("#1d2429", "#414b53", "#e8eaec", "#77838c"))
INK, FAINT, PANEL = (pygame.Color(name) for name in ("#f4f5f6", "#a9b3ba", "#12171bf0"))
NEXT_GATE, CAR, TYRE, TRAIL = (pygame.Color(name) for name in ("#f0e442", "#f0e442", "#0b0e10", "#56b4e9"))
NEAR, MIDDLE, FAR = (pygame.Color(name) for name in ("#d55e00", "#f0e442", "#56b4e9"))
CRASH = pygame.Color("#d55e00")
FLEET = tuple(pygame.Color(name) for name in ("#f0e442", "#56b4e9", "#e69f00", "#cc79a7", "#00c794"))
"""Of the cars in the picture of all, in turn."""


def nearness_colour(reading: float) -> pygame.Color:
    """The colour of a ray that reads this, 0..1."""
    return NEAR.lerp(MIDDLE, min(1, 2 * reading)) if reading < 0.5 else MIDDLE.lerp(FAR, min(1, 2 * reading - 1))
