"""Pictures of cars on the road, drawn with pygame: one that follows a car, and one of all cars on the whole track.

Both are drawn on surfaces in memory; only `Window` needs a display.
"""

import os
import warnings

from carrl.errors import ConfigError

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
try:
    with warnings.catch_warnings():
        # pygame 2.6 imports setuptools' pkg_resources where that exists, which then warns of its own end.
        warnings.filterwarnings("ignore", "pkg_resources is deprecated")
        warnings.filterwarnings("ignore", r"Deprecated call to `pkg_resources", DeprecationWarning)
        import pygame.font  # noqa: F401 (before the modules below, which need it)
except ImportError as error:
    raise ConfigError("drawing needs pygame, which is not installed; pip install 'carrl[render]'") from error

from carrl.render.raster.brush import SIZE, pixels
from carrl.render.raster.fleet import FleetPicture
from carrl.render.raster.follow import FollowPicture
from carrl.render.raster.scene import CarLook, Scene
from carrl.render.raster.window import Window

__all__ = ["SIZE", "CarLook", "FleetPicture", "FollowPicture", "Scene", "Window", "pixels"]
