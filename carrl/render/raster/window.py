"""Pictures on the display."""

import os
import sys

import pygame

from carrl.errors import ConfigError
from carrl.render.raster.projection import Size

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")  # one of them is set wherever a window can be seen


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
