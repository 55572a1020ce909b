"""The colours of a video, and the palette of a GIF: each colour, and what it mixes with a background to.

Shapes: `N` colours.
"""

from itertools import product

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from carrl.render.figure import BLACK, BLUE, FAINT, GREEN, INK, PAPER, ROAD, VERMILLION, WALL, YELLOW

OLD_TRAIL, TO_COME, RULE = "#a8a8a8", "#c4c4c4", "#e0e0e0"
"""The line driven long ago, the return still to come, thin lines between parts of the panel."""
_FOREGROUNDS = (INK, FAINT, BLACK, BLUE, VERMILLION, GREEN, YELLOW, WALL, OLD_TRAIL, TO_COME, RULE)
_BACKGROUNDS = (PAPER, ROAD, YELLOW)
_SHADES = 8
"""Steps from a background to a colour on it: at an antialiased edge the two are mixed."""


def gif_palette() -> NDArray[np.uint8]:
    """Every colour that a picture has, or one very near to it, [N, 3], N at most 256."""
    mixed = np.linspace(0, 1, _SHADES)[:, None]
    pairs = product(_BACKGROUNDS[:2], _FOREGROUNDS), product(_BACKGROUNDS[2:], (INK,))
    ways = [(1 - mixed) * to_rgb(ground) + mixed * to_rgb(colour) for pair in pairs for ground, colour in pair]
    return np.unique(np.round(255 * np.vstack(ways)).astype(np.uint8), axis=0)
