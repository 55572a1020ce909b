"""A window on the display."""

import os
import sys
import warnings
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from carrl.errors import ConfigError

if TYPE_CHECKING:
    from carrl.render.canvas import Picture

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")  # one of them is set wherever a window can be seen
WITHOUT = "render_mode='rgb_array' needs no display"
"""What an environment does without a window."""
_NO_PYGAME = "a window needs pygame, which is not installed; pip install 'carrl[render]'"


class Window:
    """A window on the display that shows pictures at a steady pace.

    Args:
        size: width and height, px.
        title: above it.
        instead: what needs no display, for the message where there is none.

    Raises:
        ConfigError: there is no display, or no pygame.
    """

    def __init__(self, size: tuple[int, int], title: str, instead: str = WITHOUT) -> None:
        """Opens it."""
        check_can_open(instead)
        self._pygame = pygame = _import_pygame()
        try:
            pygame.display.init()
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            pygame.display.quit()
            raise ConfigError(_no_window(str(error), instead)) from error
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()

    def show(self, picture: "Picture", fps: float) -> None:
        """Shows a picture [H, W, 3], no sooner than 1 / fps seconds after the one before."""
        pygame, (height, width) = self._pygame, picture.shape[:2]
        self._screen.blit(pygame.image.frombuffer(picture.tobytes(), (width, height), "RGB"), (0, 0))
        pygame.event.pump()
        self._clock.tick(fps)
        pygame.display.flip()

    def close(self) -> None:
        """Closes it; twice is no harm."""
        self._pygame.display.quit()


def check_can_open(instead: str = WITHOUT) -> None:
    """Raises ConfigError where there is no pygame, or no display; without one SDL 2.28 draws where nobody sees it."""
    if find_spec("pygame") is None:
        raise ConfigError(_NO_PYGAME if instead == WITHOUT else f"{_NO_PYGAME}; {instead}")
    if sys.platform == "linux" and not any(name in os.environ for name in DISPLAYS):
        raise ConfigError(_no_window("no display was found", instead))


def _no_window(reason: str, instead: str) -> str:
    return f"no window can be opened: {reason}; {instead}"


def _import_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        with warnings.catch_warnings():
            # pygame 2.6 imports setuptools' pkg_resources where that exists, which then warns of its own end.
            warnings.filterwarnings("ignore", ".*pkg_resources")
            import pygame
    except ImportError as error:
        raise ConfigError(_NO_PYGAME) from error
    return pygame
