"""The track that cars drive on: its road, walls and gates.

Shapes: `P` points of the centreline, `G` gates, `K` any points.
"""

from dataclasses import dataclass, field

import numpy as np
import pygame
from numpy.typing import NDArray

from carrl.render.raster.brush import draw_across
from carrl.render.raster.palette import GATE, INK, NEXT_GATE, ROAD, TYRE, WALL
from carrl.render.raster.projection import Floats, Projection
from carrl.tracks.bridges import on_stretch
from carrl.tracks.track import Track

_CHEQUER = 0.5  # side of a square of the start line, m


@dataclass
class Ground:
    """A track, cut into the pieces that are drawn: at bridges, those that are over come last."""

    track: Track
    road: Floats = field(init=False)
    """From each point of the centreline to the next: left wall there and back along the right one, [P, 4, 2], m."""
    gates: Floats = field(init=False)
    """Left and right end, [G, 2, 2], m."""
    middle: Floats = field(init=False)
    """The centreline, [P, 2], m."""

    def __post_init__(self) -> None:
        """Cuts it."""
        left, right = (side.numpy().astype(np.float64) for side in (self.track.left_wall, self.track.right_wall))
        self.road = np.stack([left, np.roll(left, -1, 0), np.roll(right, -1, 0), right], axis=1)
        self.gates = self.track.gates.numpy().astype(np.float64)
        self.middle = self.track.centreline.numpy().astype(np.float64)
        steps = np.linalg.norm(np.roll(self.middle, -1, 0) - self.middle, axis=1)
        self._road_is_over = self._is_over(steps.cumsum() - steps / 2)
        self._gate_is_over = self._is_over(self.track.gate_stations.numpy())
        self._low, self._high = self.road.min(axis=1), self.road.max(axis=1)

    def draw(self, surface: pygame.Surface, view: Projection, next_gate: int | None) -> None:
        """Draws what is in view."""
        road = view.sees(self._low, self._high)
        gates = view.sees(self.gates.min(axis=1), self.gates.max(axis=1))
        for over in (False, True):
            pieces = view(self.road[road & (self._road_is_over == over)]).tolist()
            for piece in pieces:
                pygame.draw.polygon(surface, ROAD, piece)
            for gate in np.flatnonzero(gates & (self._gate_is_over == over)):
                self._draw_gate(surface, view, int(gate), next_gate)
            width = max(2, round(0.2 * view.scale))
            for left, left_end, right_end, right in pieces:
                for begin, end in ((left, left_end), (right, right_end)):
                    pygame.draw.line(surface, WALL, begin, end, width)
                    pygame.draw.circle(surface, WALL, end, (width - 1) / 2)

    def _draw_gate(self, surface: pygame.Surface, view: Projection, gate: int, next_gate: int | None) -> None:
        """The last gate is the start line."""
        if gate == len(self.gates) - 1:
            _draw_chequers(surface, view, self.gates[gate])
        elif gate != next_gate:
            draw_across(surface, view(self.gates[gate]), GATE, max(2, round(0.12 * view.scale)))
        if gate == next_gate:
            draw_across(surface, view(self.gates[gate]), NEXT_GATE, max(3, round(0.25 * view.scale)))

    def _is_over(self, stations: Floats) -> NDArray[np.bool_]:
        """Whether stations [K], m, lie on the upper road of a bridge, [K]."""
        over = np.zeros(len(stations), dtype=bool)
        for bridge in self.track.bridges:
            over |= on_stretch(stations, bridge.over, self.track.length)
        return over


def _draw_chequers(surface: pygame.Surface, view: Projection, gate: Floats) -> None:
    """Two rows of black and white squares along a gate [2, 2], m."""
    count = max(2, round(float(np.linalg.norm(gate[1] - gate[0])) / _CHEQUER))
    across = (gate[1] - gate[0]) / count
    forward = np.array([-across[1], across[0]])
    for row in (-1, 0):
        for column in range(count):
            corner = gate[0] + column * across + row * forward
            square = np.stack([corner, corner + across, corner + across + forward, corner + forward])
            pygame.draw.polygon(surface, INK if (row + column) % 2 else TYRE, view(square).tolist())
