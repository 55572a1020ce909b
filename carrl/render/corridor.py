"""A picture of free space that is not one closed corridor."""

from pathlib import Path

from carrl.errors import printable
from carrl.render.curves import WIDTH, new_figure, save_figure
from carrl.tracks.rings import CorridorError

_MOST_PIXELS = 1000
"""Of a side of the picture that is drawn."""


def draw_corridor(path: Path, error: CorridorError) -> None:
    """Draws free space in white, the closed lines found in it, and the place that the error speaks of.

    Raises:
        CarrlError: the picture cannot be written there.
    """
    figure = new_figure(WIDTH)
    axes = figure.subplots()
    if error.free is not None:
        step = max(1, max(error.free.shape) // _MOST_PIXELS)
        rows, columns = error.free.shape
        axes.imshow(error.free[::step, ::step], cmap="gray", origin="lower", extent=(0, columns, 0, rows))
    for index, ring in enumerate(error.rings):
        axes.plot(*ring.T, color=f"C{index % 10}", linewidth=2)
    if error.place is not None:
        axes.plot(*error.place, marker="o", markersize=16, markerfacecolor="none", markeredgewidth=3, color="red")
    axes.set_title(printable(str(error)), fontsize=8, wrap=True)
    axes.set_aspect("equal")
    save_figure(figure, path)
