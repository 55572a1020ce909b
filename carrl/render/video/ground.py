"""The track in a frame: road, walls, numbered gates, the start line with the driving direction, and a scale bar.

Shapes: `G` gates, `N` points of a line. Lengths on the track are in metres, in the picture in pixels.
"""

import numpy as np

from carrl.log.scene import Floats
from carrl.render.figure import FAINT, GATE, GREEN, INK, ROAD, WALL
from carrl.render.video.camera import Area, View
from carrl.render.video.canvas import Canvas, Stroke

SCALES = 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000
"""Lengths that a scale bar may have, m."""
LEAST_BAR = 50.0
"""Of a scale bar, pixels."""


def draw_ground(canvas: Canvas, view: View, walls: list[Floats], gates: Floats, lit: list[int]) -> None:
    """Draws a track.

    Args:
        canvas: to draw on.
        view: what of the world is seen.
        walls: as connected lines, [N, 2] each, m; where they are two, the road between them is filled.
        gates: [G, 2, 2], m, the last one the start line.
        lit: gates that light up.
    """
    sides, gates = [view.pixels(wall) for wall in walls], view.pixels(gates)
    if len(sides) == 2:
        canvas.area([sides[0], sides[1][::-1]], ROAD)
    canvas.segments(gates, Stroke(GATE, 3))
    canvas.segments(gates[lit], Stroke(GREEN, 6))
    for side in sides:
        canvas.line(side, Stroke(WALL, 2))
    _draw_start(canvas, gates[-1])
    _number_gates(canvas, view.area, gates)


def draw_scale_bar(canvas: Canvas, view: View, left: float) -> None:
    """A line as long as a round number of metres, at the bottom."""
    metres = next((length for length in SCALES if length * view.scale >= LEAST_BAR), SCALES[-1])
    y, right = view.area.bottom - 18, left + metres * view.scale
    canvas.line([(left, y - 5), (left, y), (right, y), (right, y - 5)], Stroke(INK, 1.6))
    canvas.text((left + right) / 2, y - 7, f"{metres:,} m", 15, INK, anchor="ms")


def _draw_start(canvas: Canvas, line: Floats) -> None:
    """A dark line between its ends (left, right) [2, 2], px, and before it a triangle in the driving direction."""
    canvas.line(line, Stroke(INK, 4))
    across = (line[1] - line[0]) / max(1e-9, float(np.linalg.norm(line[1] - line[0])))
    forward, middle = np.array([across[1], -across[0]]), line.mean(axis=0)
    triangle = [middle + 6 * forward + 7 * across, middle + 6 * forward - 7 * across, middle + 18 * forward]
    canvas.area([triangle], INK)


def _number_gates(canvas: Canvas, area: Area, gates: Floats) -> None:
    """A number beside the left end of each gate [G, 2, 2], px, that is in the picture; the last one is the start."""
    outwards = gates[:, 0] - gates[:, 1]
    places = gates[:, 0] + 16 * outwards / np.maximum(1e-9, np.linalg.norm(outwards, axis=1))[:, None]
    inner = area.inset(12)
    seen = np.all((places >= (inner.left, inner.top)) & (places <= (inner.right, inner.bottom)), axis=1)
    for gate in np.flatnonzero(seen):
        name = "start" if gate == len(gates) - 1 else str(gate + 1)
        canvas.text(places[gate, 0], places[gate, 1], name, 15, FAINT, anchor="mm")
