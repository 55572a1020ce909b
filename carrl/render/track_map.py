"""A map of a track on paper: the road with its numbered gates, the start, a scale, and a close-up of a place.

Shapes: `P` points of the centreline, `K` places. Lengths are in metres, on the paper in points.

Source: the paper's figure 2 (the track, the car, the gates; the green lines are its sensors).
"""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.path import Path as Outline

from carrl.errors import printable
from carrl.render import round_number
from carrl.render.canvas import Area, Canvas, Floats, Stroke, View, closed
from carrl.render.colours import FAINT, INK, PAPER
from carrl.render.curves import WIDTH, save_drawing
from carrl.render.scene import PRINT, Ground, draw_ground, draw_scale_bar

if TYPE_CHECKING:
    from carrl.log.scene import TrackShape
    from carrl.tracks.track import Track

MOST_GATE_NUMBERS = 24
MARGIN, HEAD, FOOT, TALLEST = 32.0, 14.0, 24.0, 430.0
"""Room for labels around the road, for the title and for the legend, and the most height of the road itself; points."""
LEGIBLE = 1.5
"""A map with at least so many points per metre needs no close-up."""
RADIUS = 24.0
"""Half the side of the square that a close-up shows, m."""
LARGEST, SMALLEST = 165.0, 80.0
"""Side of a close-up on the paper, points: at most, and what it must have to be worth drawing."""


@dataclass(frozen=True, eq=False)
class TrackMap:
    """A map as large as the common width and TALLEST allow.

    Attributes:
        track: what it shows.
        title: above it.
    """

    track: "Track | TrackShape"
    title: str

    @cached_property
    def ground(self) -> Ground:
        """The track to be drawn."""
        return Ground.of(self.track)

    @cached_property
    def size(self) -> tuple[float, float]:
        """Width and height, points."""
        left, bottom, right, top = self.ground.bounds
        scale = min((72 * WIDTH - 2 * MARGIN) / (right - left), TALLEST / (top - bottom))
        return 72 * WIDTH, (top - bottom) * scale + HEAD + FOOT + 2 * MARGIN

    @cached_property
    def view(self) -> View:
        """All of the track, with a strip free above it for the title and one below it for a legend."""
        width, height = self.size
        return View.whole(
            self.ground.bounds, Area(MARGIN, HEAD + MARGIN, width - 2 * MARGIN, height - HEAD - FOOT - 2 * MARGIN)
        )

    def draw(self, canvas: Canvas) -> None:
        """Draws the map."""
        draw_ground(canvas, self.view, self.ground, PRINT)
        reference_line = getattr(self.track, "reference_line", None)  # a log does not have it
        if reference_line is not None:
            reference = self.view.places(reference_line.double().numpy())
            canvas.path(closed([reference]), Stroke(FAINT, 0.8))
        covered = self._draw_start(canvas)
        self._number_gates(canvas, covered)
        draw_scale_bar(canvas, self.view, 14, self.size[1] - 14, PRINT, least=35, size=8)
        lines = textwrap.wrap(printable(self.title), 100, max_lines=2, placeholder="...")
        for index, line in enumerate(lines):
            canvas.text((self.size[0] / 2, 17 + 13 * index), line, 10.5, INK, anchor="ms")

    def close_up(self, places: Floats) -> View | None:
        """A view, inside the map, of the surroundings of one of the places [K, 2], m; None if needless or no room."""
        if self.view.scale >= LEGIBLE or len(places) == 0:
            return None
        middle, side = self._free_square(self.view.places(places))
        if side < SMALLEST:
            return None
        centre = places[np.linalg.norm(self.view.places(places) - middle, axis=1).argmin()]
        area = Area(middle[0] - side / 2, middle[1] - side / 2, side, side)
        return View(area, centre, side / (2 * RADIUS))

    def draw_close_up(self, canvas: Canvas, view: View, draw_scene: Callable[[Canvas, View], None]) -> None:
        """Draws the track and what else there is in a close-up, and a line to it from the place that it shows."""
        half, middle = max(RADIUS * self.view.scale, 7.0), np.array(view.area.middle)
        place, edge = self.view.places(view.centre), Stroke(FAINT, 0.8)
        canvas.path(_square(place, half), edge)
        way = middle - place
        reach = np.abs(way).max()
        canvas.line([place + way * half / reach, middle - way * view.area.width / 2 / reach], edge)
        canvas.box(view.area.left, view.area.top, view.area.width, view.area.height, PAPER)
        with canvas.clipped(view.area):
            draw_ground(canvas, view, self.ground, PRINT)
            draw_scene(canvas, view)
        canvas.path(_square(middle, view.area.width / 2), edge)
        self._write(canvas, np.array([middle[0], view.area.bottom + 8]), f"close-up, {2 * RADIUS:g} m wide")

    @cached_property
    def _road(self) -> Floats:
        """The centreline on the paper, [P, 2]."""
        return self.view.places(self.ground.centreline)

    def _free_square(self, places: Floats) -> tuple[Floats, float]:
        """Middle [2] and side of a square clear of road, labels and edges; of the large ones, nearest to a place."""
        width, height = self.size
        frame = Area(10, HEAD + 10, width - 20, height - HEAD - FOOT - 20)
        axes = np.linspace(frame.left, frame.right, 60), np.linspace(frame.top, frame.bottom, 60)
        candidates = np.stack([axis.ravel() for axis in np.meshgrid(*axes)], axis=-1)
        road = self._road[:: max(1, len(self._road) // 400)]
        # The Chebyshev distance: half the side of the largest square around a candidate that the road does not enter.
        room = np.abs(candidates[:, None] - road).max(axis=-1).min(axis=1) - 26
        corners = (frame.left, frame.top), (frame.right, frame.bottom)
        edges = np.concatenate([candidates - corners[0], corners[1] - candidates], axis=1).min(axis=1)
        side = np.minimum(2 * np.minimum(room, edges), LARGEST)
        distance = np.linalg.norm(candidates[:, None] - places, axis=-1).min(axis=1)
        best = np.where(side >= 0.95 * side.max(), distance, np.inf).argmin()
        return candidates[best], float(side[best])

    def _draw_start(self, canvas: Canvas) -> Floats:
        """The word and an arrow in the driving direction, on the roomier side; returns what they cover, [K, 2]."""
        line = self.view.places(self.ground.gates[-1])
        across = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        # The centreline is not square to the line where that stands in a corner.
        ahead = self.ground.centreline[1] - self.ground.centreline[0]
        forward = np.array([ahead[0], -ahead[1]]) / np.linalg.norm(ahead)
        # The word stands before the arrow; it is wider than high, so it needs more room where it meets it sideways.
        behind, aside = 6 + 9 * abs(across[1]), 9 + 5 * abs(across[0])
        sides = [np.stack([place - behind * forward, place, place + 26 * forward]) for place in _beside(line, aside)]
        word, tail, head = covered = max(sides, key=self._room)
        self._write(canvas, word, "start")
        side = np.array([-forward[1], forward[0]])
        canvas.line([tail, head - 5 * forward], Stroke(INK, 1.2))
        canvas.area([[head, head - 7 * forward + 2.6 * side, head - 7 * forward - 2.6 * side]], INK)
        return np.asarray(covered)

    def _number_gates(self, canvas: Canvas, covered: Floats) -> None:
        """Numbers where there is more room, but none on the places [K, 2]; the last gate is the start."""
        gates = self.view.places(self.ground.gates)
        every = round(round_number(max(1.0, len(gates) / MOST_GATE_NUMBERS)))
        for index in range(every - 1, len(gates) - 1, every):
            place = max(_beside(gates[index]), key=lambda place: self._room(place[None]))
            if np.linalg.norm(covered - place, axis=1).min() > 20:
                self._write(canvas, place, str(index + 1))
                covered = np.vstack([covered, place])

    def _room(self, places: Floats) -> float:
        """Distance from the centreline to the nearest of the places [K, 2], points."""
        return float(np.linalg.norm(self._road[:, None] - places, axis=-1).min())

    @staticmethod
    def _write(canvas: Canvas, place: Floats, text: str) -> None:
        canvas.text(place, text, 8, INK, anchor="mm", rim=PAPER)


def draw_track_map(path: str | Path, track: "Track", title: str) -> None:
    """Writes a picture of the track, a .png, .pdf or .svg.

    Raises:
        CarrlError: it ends in another, or cannot be written there.
    """
    track_map = TrackMap(track, title)
    save_drawing(path, track_map.size, track_map.draw)


def _beside(gate: Floats, distance: float = 9.0) -> tuple[Floats, Floats]:
    """Places for a label outside both ends of a gate [2, 2], at a distance: two points [2]."""
    outwards = (gate[0] - gate[1]) / np.linalg.norm(gate[0] - gate[1]) * distance
    return gate[0] + outwards, gate[1] - outwards


def _square(middle: Floats, half: float) -> Outline:
    return closed([middle + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])])
