"""What every figure shares: size, axes, and a way onto the disk that never leaves half a picture."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from carrl.files import write_whole
from carrl.render import picture_format
from carrl.render.canvas import Canvas, PixelCanvas
from carrl.render.colours import FAINT, INK, PAPER

WIDTH = 7.0
"""Width of a figure, inches."""
DPI = 130
"""Pixels per inch: a figure is 910 pixels wide, about as wide as a README."""
_UNDATED = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""The same figure gives the same bytes."""


def new_figure(height: float) -> Figure:
    """A white figure of the common width, height in inches, in no window and no global state."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain_axes(axes: Axes) -> None:
    """Gives axes of a diagram two thin spines, small ticks and faint horizontal lines."""
    axes.set_facecolor("white")
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set(color=FAINT, linewidth=0.8)
    axes.tick_params(colors=FAINT, labelcolor=INK, labelsize=8, width=0.8, length=3)
    axes.grid(axis="y", color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes the figure to `path`, whole or not at all: a reader sees the old picture or the new one.

    The format is that which the name ends in: .png, .pdf or .svg.

    Raises:
        CarrlError: it ends in another, or cannot be written there.
    """
    kind, picture = picture_format(path), BytesIO()
    figure.savefig(picture, format=kind, dpi=DPI, facecolor="white", metadata=_UNDATED.get(kind))
    write_whole(path, picture.getvalue())


def save_drawing(path: str | Path, size: tuple[float, float], draw: Callable[[Canvas], None]) -> None:
    """Writes what is drawn on a canvas of this size, points, as `save_figure` does."""
    if picture_format(path) != "png":
        figure = Figure(figsize=(size[0] / 72, size[1] / 72))
        figure.add_artist(_Drawing(draw))
        save_figure(figure, path)
        return
    canvas, file = PixelCanvas(*size, scale=DPI / 72), BytesIO()
    canvas.clear(PAPER)
    draw(canvas)
    Image.fromarray(canvas.picture()).save(file, format="PNG", dpi=(DPI, DPI))
    write_whole(path, file.getvalue())


class _Drawing(Artist):
    """A drawing as a part of one of Matplotlib's figures, whose units are points."""

    def __init__(self, draw: Callable[[Canvas], None]) -> None:
        super().__init__()
        self._draw_on = draw

    def draw(self, renderer: RendererBase) -> None:
        self._draw_on(Canvas(renderer))  # in PDF and SVG a pixel is a point
