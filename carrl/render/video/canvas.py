"""A picture that is drawn anew for every frame: shapes by matplotlib's Agg, text by Pillow.

Coordinates are pixels of a picture 1280 wide, x to the right, y *down* from the top; a smaller picture is scaled.
Shapes: `N` points, `H` and `W` pixels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib import get_data_path
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import to_rgb
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT = 1280, 720
"""The picture in its own coordinates."""
Picture = NDArray[np.uint8]
"""Red, green, blue and an opacity that is always full, [H, W, 4]."""
Anchor = Literal["ls", "ms", "rs", "mm"]
"""What of a text stands at its place: left, middle or right of its base line, or its very middle."""
_CIRCLE = Outline.unit_circle()


@dataclass(frozen=True)
class Stroke:
    """How a line looks: its colour, and its width in pixels."""

    colour: str
    width: float


class Canvas:
    """An empty picture.

    Args:
        width: pixels; the height follows.
    """

    def __init__(self, width: int) -> None:
        self.size = width, width * HEIGHT // WIDTH
        self._scale = width / WIDTH
        self._agg = RendererAgg(*self.size, 72)
        self._to_agg = Affine2D().scale(self._scale, -self._scale).translate(0, self.size[1])
        self._pixels = np.asarray(self._agg.buffer_rgba())

    def clear(self) -> None:
        """Makes it white."""
        self._pixels[:] = 255

    def line(self, points: ArrayLike, stroke: Stroke) -> None:
        """Joins the points [N, 2]."""
        self._draw(Outline(points), stroke)

    def segments(self, ends: NDArray[np.floating], stroke: Stroke) -> None:
        """Draws a line for each pair of points, [N, 2, 2]; one that begins where the last one ends goes on with it."""
        codes = np.tile([Outline.MOVETO, Outline.LINETO], len(ends))
        codes[2::2][(ends[1:, 0] == ends[:-1, 1]).all(axis=1)] = Outline.LINETO
        self._draw(Outline(ends.reshape(-1, 2), codes), stroke)

    def area(self, rings: Sequence[ArrayLike], fill: str, edge: Stroke | None = None) -> None:
        """Fills the closed rings, [N, 2] each; a ring of the other sense of rotation within another is a hole."""
        closed = [np.vstack([ring, ring[:1]]) for ring in map(np.asarray, rings)]
        self._draw(Outline.make_compound_path(*(Outline(ring, closed=True) for ring in closed)), edge, fill)

    def disc(self, centre: ArrayLike, radius: float, fill: str, edge: Stroke | None = None) -> None:
        """Fills a circle about the centre [2]."""
        self._draw(_CIRCLE.transformed(Affine2D().scale(radius).translate(*np.asarray(centre))), edge, fill)

    def box(self, left: float, top: float, width: float, height: float, fill: str, edge: Stroke | None = None) -> None:
        """Fills an upright rectangle."""
        right, bottom = left + width, top + height
        self.area([[(left, top), (right, top), (right, bottom), (left, bottom)]], fill, edge)

    def text(
        self, x: float, y: float, text: str, size: float, colour: str, *, bold: bool = False, anchor: Anchor = "ls"
    ) -> None:
        """Writes in one line, `size` pixels high."""
        letters, offset = _stamp(" ".join(text.split()), size * self._scale, bold, anchor)
        left, top = round(x * self._scale) + offset[0], round(y * self._scale) + offset[1]
        covered = self._pixels[max(0, top) : top + len(letters), max(0, left) : left + letters.shape[1], :3]
        share = letters[max(0, -top) :, max(0, -left) :][: covered.shape[0], : covered.shape[1]]
        covered[:] = covered + (255 * np.array(to_rgb(colour), np.float32) - covered) * share

    def picture(self) -> Picture:
        """What was drawn since `clear`, [H, W, 4]."""
        return self._pixels.copy()

    def _draw(self, outline: Outline, stroke: Stroke | None, fill: str | None = None) -> None:
        style = self._agg.new_gc()
        style.set_linewidth(stroke.width * self._scale if stroke else 0)
        style.set_foreground(stroke.colour if stroke else "white")
        style.set_capstyle("round")
        style.set_joinstyle("round")
        style.set_snap(False)  # or else a slow car would move in jumps of a whole pixel
        self._agg.draw_path(style, outline, self._to_agg, to_rgb(fill) if fill else None)


def fitted(text: str, size: float, width: float) -> str:
    """The text, or as much of its beginning as fits into so many pixels at this size."""
    text = " ".join(text.split())
    if _font(size, bold=True).getlength(text) <= width:
        return text
    while text and _font(size, bold=True).getlength(text + "…") > width:
        text = text[:-1]
    return text.rstrip() + "…"


@lru_cache(maxsize=2048)
def _stamp(text: str, size: float, bold: bool, anchor: Anchor) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """How far letters cover each pixel, [h, w, 1] in 0..1, and where its corner lies from the place of the anchor."""
    font = _font(size, bold)
    left, top, right, bottom = font.getbbox(text, anchor=anchor)
    left, top = math.floor(left), math.floor(top)
    mask = Image.new("L", (math.ceil(right) - left, math.ceil(bottom) - top))
    ImageDraw.Draw(mask).text((-left, -top), text, 255, font, anchor)
    return np.asarray(mask, dtype=np.float32)[:, :, None] / np.float32(255), (left, top)


@cache
def _font(size: float, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(get_data_path(), "fonts", "ttf", name), size)
