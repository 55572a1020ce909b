"""What every figure shares: colours, size, and a way onto the disk that never leaves half a picture."""

from io import BytesIO
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from carrl.files import write_whole
from carrl.render.picture_file import picture_format

WIDTH = 7.0
"""Width of a figure, inches."""
DPI = 130
"""Pixels per inch: a figure is 910 pixels wide, about as wide as a README."""

PAPER = "#ffffff"
ROAD, WALL, GATE = "#dcdcdc", "#555555", "#ffffff"
"""Of a track on a white ground."""
INK = "#222222"
FAINT = "#6b6b6b"
BLACK = "#000000"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
YELLOW = "#F0E442"
PURPLE = "#CC79A7"
ORANGE = "#E69F00"
SKY = "#56B4E9"
"""The last eight are Okabe and Ito's (2008) colours, which colour-blind readers can tell apart."""


def new_figure(height: float, constrained: bool = True) -> Figure:
    """A white figure of the common width, height in inches, in no window and no global state."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white", layout="constrained" if constrained else None)
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
    undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    figure.savefig(picture, format=kind, dpi=DPI, facecolor="white", metadata=undated.get(kind))
    write_whole(path, picture.getvalue())
