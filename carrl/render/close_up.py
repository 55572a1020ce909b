"""A close-up of one place of a long circuit, in a free corner of its map, where the road is too thin to show a car.

Shapes: `K` places that may be enlarged.
"""

import numpy as np
from matplotlib.patches import Rectangle

from carrl.render.figure import FAINT
from carrl.render.track_map import Floats, TrackMap, draw_gates, draw_road, write
from carrl.tracks.track import Track

LEGIBLE = 1.5
"""A map with at least so many points per metre needs no close-up."""
RADIUS = 24.0
"""Half the side of the square that a close-up shows, m."""
LARGEST, SMALLEST = 165.0, 80.0
"""Side of a close-up on the paper, points: at most, and what it must have to be worth drawing."""


def draw_close_up(track_map: TrackMap, track: Track, places: Floats) -> TrackMap | None:
    """A second map inside the first, of the surroundings of one of the places [K, 2]; None if needless or no room."""
    if track_map.scale >= LEGIBLE or len(places) == 0:
        return None
    middle, side = _free_square(track_map, track, places)
    if side * track_map.scale < SMALLEST:
        return None
    centre = places[np.linalg.norm(places - middle, axis=1).argmin()]
    corner = middle - side / 2
    axes = track_map.axes.inset_axes((corner[0], corner[1], side, side), transform=track_map.axes.transData, zorder=10)
    axes.set(xlim=(centre[0] - RADIUS, centre[0] + RADIUS), ylim=(centre[1] - RADIUS, centre[1] + RADIUS))
    axes.set(xticks=[], yticks=[], facecolor="white")
    axes.spines[:].set(color=FAINT, linewidth=0.8)
    close_up = TrackMap(track_map.figure, axes, scale=side * track_map.scale / (2 * RADIUS))
    draw_road(close_up, track)
    draw_gates(close_up, track)
    write(axes, centre - (0, RADIUS + 8 / close_up.scale), f"close-up, {2 * RADIUS:g} m wide")
    _draw_frame(track_map, centre, middle, side)
    return close_up


def _free_square(track_map: TrackMap, track: Track, places: Floats) -> tuple[Floats, float]:
    """Middle [2] and side, m, of a square clear of road, labels and edges; of the large ones, nearest to a place."""
    left, bottom, right, top = track_map.frame
    grid = np.meshgrid(np.linspace(left, right, 60), np.linspace(bottom, top, 60))
    candidates = np.stack([axis.ravel() for axis in grid], axis=-1)
    road = track.centreline.numpy()[:: max(1, len(track.centreline) // 400)]
    labels = 26 / track_map.scale
    # The Chebyshev distance: half the side of the largest square around a candidate that the road does not enter.
    room = np.abs(candidates[:, None] - road).max(axis=-1).min(axis=1) - labels
    edges = np.concatenate([candidates - (left, bottom), (right, top) - candidates], axis=1).min(axis=1)
    side = np.minimum(2 * np.minimum(room, edges), LARGEST / track_map.scale)
    distance = np.linalg.norm(candidates[:, None] - places, axis=-1).min(axis=1)
    best = np.where(side >= 0.95 * side.max(), distance, np.inf).argmin()
    return candidates[best], float(side[best])


def _draw_frame(track_map: TrackMap, centre: Floats, middle: Floats, side: float) -> None:
    """A small square round the place that is enlarged, and a line from it to the close-up."""
    half = max(RADIUS, 7 / track_map.scale)
    square = Rectangle((centre[0] - half, centre[1] - half), 2 * half, 2 * half)
    square.set(facecolor="none", edgecolor=FAINT, linewidth=0.8, zorder=8)
    track_map.axes.add_patch(square)
    way = middle - centre
    reach = np.abs(way).max()
    ends = np.stack([centre + way * half / reach, middle - way * side / 2 / reach])
    track_map.axes.plot(*ends.T, color=FAINT, linewidth=0.8, zorder=8)
