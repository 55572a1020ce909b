"""A picture of free space that is not one closed corridor."""

from matplotlib.figure import Figure

from carrl.printable import printable
from carrl.tracks.rings import CorridorError

_MOST_PIXELS = 1000
"""Of a side of the picture that is drawn."""


def draw_corridor(error: CorridorError) -> Figure:
    """Free space in white, the closed lines that were found in it, and the place that the error speaks of."""
    figure = Figure(figsize=(8, 8), layout="constrained")
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
    return figure
