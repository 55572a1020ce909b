"""Shapes and text on a picture of any kind, and which part of the world it shows.

A canvas draws by any renderer of Matplotlib: into pixels for screens, videos and PNG, into paths for PDF and SVG. Its
coordinates are its own units, x to the right, y *down* from the top: pixels on a screen, points (1/72 inch) on paper.
Shapes: `N` points, `H` and `W` pixels.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Literal, NamedTuple, cast

import numpy as np
from matplotlib import get_data_path
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from matplotlib.transforms import Affine2D, Bbox
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from carrl.render.colours import PAPER, rgb

Floats = NDArray[np.floating]
Picture = NDArray[np.uint8]
"""Red, green and blue, [H, W, 3]."""
Anchor = Literal["ls", "ms", "rs", "mm"]
"""What of a text stands at its place: left, middle or right of its base line, or its very middle."""
_CIRCLE = Outline.unit_circle()
_RIM = 2.5
"""Width of the rim about letters, which makes them readable on lines, units."""


@dataclass(frozen=True)
class Stroke:
    """How a line looks: its colour, its width in units, and its ends."""

    colour: str
    width: float
    cap: Literal["round", "butt"] = "round"


@dataclass(frozen=True)
class Area:
    """A rectangle of the picture, units."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Of the rectangle."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Of the rectangle."""
        return self.top + self.height

    @property
    def middle(self) -> tuple[float, float]:
        """Of the rectangle."""
        return self.left + self.width / 2, self.top + self.height / 2

    def inset(self, margin: float) -> "Area":
        """The rectangle without a margin on all four sides."""
        return Area(self.left + margin, self.top + margin, self.width - 2 * margin, self.height - 2 * margin)

    def holds(self, places: ArrayLike) -> NDArray[np.bool_]:
        """Which of the places [..., 2] are in the rectangle, [...]."""
        places = np.asarray(places)
        inside = (places >= (self.left, self.top)) & (places <= (self.right, self.bottom))
        return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True, eq=False)
class View:
    """A camera: which place of the world an area of the picture shows, and how large.

    Attributes:
        area: of the picture.
        centre: what the middle of the area shows, [2], m.
        scale: units per metre.
    """

    area: Area
    centre: ArrayLike
    scale: float

    @staticmethod
    def whole(bounds: tuple[float, float, float, float], area: Area) -> "View":
        """All between the least x and y and the greatest x and y, m, as large as it fits."""
        left, bottom, right, top = bounds
        scale = min(area.width / (right - left), area.height / (top - bottom))
        return View(area, np.array([left + right, bottom + top]) / 2, scale)

    def places(self, points: ArrayLike) -> Floats:
        """Where points of the world [..., 2] appear in the picture, [..., 2]."""
        return np.asarray(self.area.middle + (np.asarray(points) - self.centre) * (self.scale, -self.scale))

    @cached_property
    def transform(self) -> Affine2D:
        """What `places` does, for Matplotlib."""
        return Affine2D().scale(self.scale, -self.scale).translate(*self.places(np.zeros(2)))


class _Line(NamedTuple):
    """A line of text."""

    text: str
    size: float
    bold: bool
    anchor: Anchor


class Canvas:
    """What a renderer draws on.

    Args:
        renderer: of Matplotlib.
        scale: pixels of the renderer per unit.
    """

    def __init__(self, renderer: RendererBase, scale: float = 1.0) -> None:
        """Draws nothing yet."""
        self._renderer, self._scale, self._clip = renderer, scale, cast(Bbox | None, None)
        self._to_pixels = Affine2D().scale(scale, -scale).translate(0, renderer.get_canvas_width_height()[1])

    def path(
        self, outline: Outline, stroke: Stroke | None = None, fill: str | None = None, view: View | None = None
    ) -> None:
        """Strokes and fills an outline in units, or in metres of the world that the view shows."""
        style = self._renderer.new_gc()
        style.set_linewidth(stroke.width * self._scale if stroke else 0)
        style.set_foreground(_rgb(stroke.colour if stroke else PAPER), isRGBA=True)
        style.set_capstyle(stroke.cap if stroke else "round")
        style.set_joinstyle("round")
        style.set_snap(False)  # or else a slow car would move in jumps of a whole pixel
        if self._clip is not None:
            style.set_clip_rectangle(self._clip)
        transform = view.transform + self._to_pixels if view else self._to_pixels
        self._renderer.draw_path(style, outline, transform, _rgb(fill) if fill else None)
        style.restore()

    @contextmanager
    def clipped(self, area: Area) -> Iterator[None]:
        """Shapes, though no letters, are drawn within the area alone."""
        corners = [[area.left, area.top], [area.right, area.bottom]]
        self._clip = Bbox(self._to_pixels.transform(corners))
        yield
        self._clip = None

    def line(self, points: ArrayLike, stroke: Stroke) -> None:
        """Joins the points [N, 2]."""
        self.path(Outline(points), stroke)

    def segments(self, ends: Floats, stroke: Stroke) -> None:
        """Draws a line for each pair of points, [N, 2, 2]; one that begins where the last one ends goes on with it."""
        self.path(segments(ends), stroke)

    def area(self, rings: Sequence[ArrayLike], fill: str, edge: Stroke | None = None) -> None:
        """Fills the closed rings, [N, 2] each; a ring of the other sense of rotation within another is a hole."""
        self.path(closed(rings), edge, fill)

    def disc(self, centre: ArrayLike, radius: float, fill: str | None, edge: Stroke | None = None) -> None:
        """Fills a circle about the centre [2], or only draws its edge."""
        self.path(_CIRCLE.transformed(Affine2D().scale(radius).translate(*np.asarray(centre))), edge, fill)

    def discs(self, centres: Floats, radius: float, fill: str | None, edge: Stroke | None = None) -> None:
        """The same about several centres [N, 2] at once, which is quicker."""
        vertices = (radius * np.asarray(_CIRCLE.vertices, np.float64) + centres[:, None]).reshape(-1, 2)
        codes = np.tile(np.asarray(_CIRCLE.codes, Outline.code_type), len(centres))
        self.path(Outline(vertices, codes), edge, fill)

    def box(self, left: float, top: float, width: float, height: float, fill: str, edge: Stroke | None = None) -> None:
        """Fills an upright rectangle."""
        right, bottom = left + width, top + height
        self.area([[(left, top), (right, top), (right, bottom), (left, bottom)]], fill, edge)

    def text(
        self,
        place: ArrayLike,
        text: str,
        size: float,
        colour: str,
        *,
        bold: bool = False,
        anchor: Anchor = "ls",
        rim: str | None = None,
    ) -> None:
        """Writes in one line, `size` units high, with a rim of another colour if there is one."""
        line = _Line(" ".join(text.split()), size, bold, anchor)
        if rim:
            self._write(place, line, rim, _RIM)
        self._write(place, line, colour)

    def _write(self, place: ArrayLike, line: "_Line", colour: str, rim: float = 0.0) -> None:
        """Fills the letters, or a rim about them of this width."""
        letters = TextPath((0, 0), line.text, line.size, prop=FontProperties(fname=_font_file(line.bold)))
        x, y = np.asarray(place)
        if line.anchor != "ls" and len(letters.vertices):
            box = letters.get_extents()
            x -= {"m": (box.x0 + box.x1) / 2, "r": box.x1, "l": 0}[line.anchor[0]]
            y += (box.y0 + box.y1) / 2 if line.anchor == "mm" else 0
        outline = letters.transformed(Affine2D().scale(1, -1).translate(x, y))
        self.path(outline, Stroke(colour, rim) if rim else None, None if rim else colour)


class PixelCanvas(Canvas):
    """A picture that is drawn anew for every frame; letters are stamps, which is much quicker.

    Args:
        width: units.
        height: units.
        scale: pixels per unit.
    """

    def __init__(self, width: float, height: float, scale: float = 1.0) -> None:
        """Draws nothing yet."""
        self._agg = RendererAgg(round(width * scale), round(height * scale), 72)
        self._pixels = np.asarray(self._agg.buffer_rgba())
        self._whole_pixels = self._pixels.view(np.uint32)[:, :, 0]  # quicker to copy than their four bytes
        super().__init__(self._agg, scale)

    def clear(self, colour: str) -> None:
        """Makes all of it this colour."""
        self._whole_pixels[:] = np.array([*rgb(colour), 255], np.uint8).view(np.uint32)

    def paste(self, other: "PixelCanvas", left: float, top: float) -> None:
        """Copies what another canvas shows, unscaled, with its corner there."""
        height, width = other._whole_pixels.shape
        row, column = round(top * self._scale), round(left * self._scale)
        self._whole_pixels[row : row + height, column : column + width] = other._whole_pixels

    def copy(self, other: "PixelCanvas", area: Area) -> None:
        """Copies what another canvas of the same size shows in an area."""
        left, top, right, bottom = (round(at * self._scale) for at in (area.left, area.top, area.right, area.bottom))
        self._whole_pixels[top:bottom, left:right] = other._whole_pixels[top:bottom, left:right]

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """What is drawn, as it is until the next drawing: red, green, blue and 255, [H, W, 4]."""
        return self._pixels

    def picture(self) -> Picture:
        """A copy of what was drawn since `clear`."""
        picture = np.empty((*self._whole_pixels.shape, 3), np.uint8)
        for channel in range(3):  # five times as quick as all at once
            picture[:, :, channel] = self._pixels[:, :, channel]
        return picture

    def _write(self, place: ArrayLike, line: "_Line", colour: str, rim: float = 0.0) -> None:
        share, offset = _stamp(line._replace(size=line.size * self._scale), rim * self._scale / 2)
        left, top = (round(at * self._scale) + by for at, by in zip(np.asarray(place).tolist(), offset, strict=True))
        bottom, right = max(0, top + len(share)), max(0, left + share.shape[1])
        covered = self._pixels[max(0, top) : bottom, max(0, left) : right, :3]
        share = share[max(0, -top) :, max(0, -left) :][: covered.shape[0], : covered.shape[1]]
        covered[:] = covered + (np.array(rgb(colour), np.float32) - covered) * share


def segments(ends: Floats) -> Outline:
    """A line for each pair of points, [N, 2, 2]; one that begins where the last one ends goes on with it."""
    codes = np.tile([Outline.MOVETO, Outline.LINETO], len(ends)).astype(Outline.code_type)
    codes[2::2][(ends[1:, 0] == ends[:-1, 1]).all(axis=1)] = Outline.LINETO
    return Outline(ends.reshape(-1, 2), codes)


def closed(rings: Sequence[ArrayLike]) -> Outline:
    """Closed rings, [N, 2] each."""
    whole = [np.vstack([ring, ring[:1]]) for ring in map(np.asarray, rings)]
    codes = np.full(sum(map(len, whole)), Outline.LINETO, Outline.code_type)
    ends = np.cumsum([len(ring) for ring in whole])
    codes[0], codes[ends[:-1]], codes[ends - 1] = Outline.MOVETO, Outline.MOVETO, Outline.CLOSEPOLY
    return Outline(np.concatenate(whole), codes)


def text_width(text: str, size: float, bold: bool = False) -> float:
    """How wide a text is, units."""
    return float(_font(size, bold).getlength(text))


def fitted(text: str, size: float, width: float) -> str:
    """The text in bold, or as much of its beginning as fits into so many units at this size."""
    text = " ".join(text.split())
    if text_width(text, size, bold=True) <= width:
        return text
    while text and text_width(text + "…", size, bold=True) > width:
        text = text[:-1]
    return text.rstrip() + "…"


@cache
def _rgb(colour: str) -> tuple[float, float, float, float]:
    red, green, blue = rgb(colour)
    return red / 255, green / 255, blue / 255, 1.0


@lru_cache(maxsize=2048)
def _stamp(line: _Line, rim: float) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """How far letters cover each pixel, [h, w, 1] in 0..1, and where its corner lies from the place of the anchor."""
    font = _font(line.size, line.bold)
    left, top, right, bottom = font.getbbox(line.text, anchor=line.anchor, stroke_width=rim)
    left, top = math.floor(left), math.floor(top)
    mask = Image.new("L", (math.ceil(right) - left, math.ceil(bottom) - top))
    ImageDraw.Draw(mask).text((-left, -top), line.text, 255, font, line.anchor, stroke_width=rim)
    return np.asarray(mask, dtype=np.float32)[:, :, None] / np.float32(255), (left, top)


@cache
def _font(size: float, bold: bool) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(_font_file(bold), size)


def _font_file(bold: bool) -> Path:
    return Path(get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
