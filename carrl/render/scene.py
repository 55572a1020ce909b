"""The one drawing of a track, a car and its rays: for screens, videos and paper alike.

What differs between these is the view, and the `Style`: colours, and how wide lines are.
Shapes: `N` points of a line, `G` gates, `R` rays, `K` any points. Lengths in the world are in metres, in the picture
in units.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from carrl.log.scene import TrackShape
from carrl.render import round_number
from carrl.render.canvas import Canvas, Floats, Stroke, View, closed, segments
from carrl.render.colours import DARK, LIGHT, PAPER, Theme
from carrl.render.episode import connected_walls

if TYPE_CHECKING:
    from carrl.tracks.track import Track

SQUARE, LEAST_SQUARE = 0.5, 2.0
"""Side of a square of the start line, m, and at least, units."""
LEAST_START = 12.0
"""Length of the start line on a map so small that the road is thinner, units."""


@dataclass(frozen=True)
class Pen:
    """A width in the world, m, that is kept between two widths in the picture, units."""

    metres: float
    least: float
    most: float

    def width(self, view: View) -> float:
        """In the picture, units."""
        return min(max(self.metres * view.scale, self.least), self.most)

    def stroke(self, colour: str, view: View) -> Stroke:
        """A line of this width."""
        return Stroke(colour, self.width(view))


@dataclass(frozen=True)
class Style:
    """How a kind of picture draws the scene.

    Attributes:
        theme: its colours.
        wall: width of walls.
        gate: width of gates.
        next_gate: width of gates that stand out.
        ray: width of rays.
        ray_end: radius of the dot where a ray meets a wall.
        line: width of the line driven.
        outline: width of a car's outline.
        least_radius: of a car, units; where it would be smaller it is drawn larger.
        detailed: whether a car has a hull and wheels within its disc, or is the disc with a stroke to its nose; and
            whether a ray that meets no wall ends in a ring.
    """

    theme: Theme
    wall: Pen
    gate: Pen
    next_gate: Pen
    ray: Pen
    ray_end: Pen
    line: Pen
    outline: Pen
    least_radius: float
    detailed: bool = False


SCREEN = Style(
    DARK,
    wall=Pen(0.2, 1.2, 6),
    gate=Pen(0.12, 1, 4),
    next_gate=Pen(0.25, 1.5, 6),
    ray=Pen(0, 1, 1),
    ray_end=Pen(0, 4, 4),
    line=Pen(0, 2, 2),
    outline=Pen(0, 1, 1),
    least_radius=6.0,
    detailed=True,
)
FILM = Style(
    LIGHT,
    wall=Pen(0, 2, 2),
    gate=Pen(0, 3, 3),
    next_gate=Pen(0, 6, 6),
    ray=Pen(0, 1.6, 1.6),
    ray_end=Pen(0, 4, 4),
    line=Pen(0, 3.5, 3.5),
    outline=Pen(0, 1.8, 1.8),
    least_radius=6.0,
)
PRINT = Style(
    LIGHT,
    wall=Pen(0.25, 0.4, 1.2),
    gate=Pen(0.4, 0.5, 2.0),
    next_gate=Pen(0.4, 0.5, 2.0),
    ray=Pen(0.2, 0.5, 0.9),
    ray_end=Pen(0.35, 0.6, 1.6),
    line=Pen(0.5, 1.5, 2.2),
    outline=Pen(0, 0.75, 0.75),
    least_radius=1.8,
)


@dataclass(frozen=True, eq=False)
class Ground:
    """A track to be drawn.

    Attributes:
        name: the track's.
        walls: connected lines, [N, 2] each; where they are two, they bound the road.
        gates: left and right end in driving order, the last one the start line, [G, 2, 2].
        centreline: [N, 2].
        decks: left and right wall, [N, 2] each, of each stretch of road that leads over another.
        on_deck: which gates stand there, [G].
    """

    name: str
    walls: Sequence[Floats]
    gates: Floats
    centreline: Floats
    decks: Sequence[tuple[Floats, Floats]]
    on_deck: NDArray[np.bool_]

    @staticmethod
    def of(track: "Track | TrackShape") -> "Ground":
        """A track of the simulator, or one attached to a log, which does not tell of its bridges."""
        if isinstance(track, TrackShape):
            gates = track.gates
            return Ground(track.name, connected_walls(track), gates, track.centreline, (), np.zeros(len(gates), bool))
        from carrl.tracks.bridges import on_stretch

        left, right, middle, gates = (
            line.numpy().astype(np.float64)
            for line in (track.left_wall, track.right_wall, track.centreline, track.gates)
        )
        stations = track.gate_stations.numpy()
        on_deck = np.zeros(len(gates), dtype=bool)
        for bridge in track.bridges:
            on_deck |= on_stretch(stations, bridge.over, track.length)
        decks = [_deck(track, bridge.over) for bridge in track.bridges]
        return Ground(
            track.name, [np.vstack([side, side[:1]]) for side in (left, right)], gates, middle, decks, on_deck
        )

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x, least y, greatest x, greatest y of the walls, m."""
        points = np.concatenate(list(self.walls))
        return (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())

    @cached_property
    def road(self) -> Outline | None:
        """One wall forwards and the other backwards, which leaves a hole; None where it is not known."""
        return closed([self.walls[0], self.walls[1][::-1]]) if len(self.walls) == 2 else None

    @cached_property
    def sides(self) -> Outline:
        """The walls."""
        return Outline.make_compound_path(*map(Outline, self.walls))

    @cached_property
    def gate_lines(self) -> tuple[Outline, Outline]:
        """Those on the ground, and those on a bridge."""
        return segments(self.gates[~self.on_deck]), segments(self.gates[self.on_deck])


def draw_ground(canvas: Canvas, view: View, ground: Ground, style: Style, lit: Collection[int] = ()) -> None:
    """Draws the road, its walls, its gates, some of which stand out, and the start line."""
    theme, wall = style.theme, style.wall.stroke(style.theme.wall, view)
    if ground.road:
        canvas.path(ground.road, fill=theme.road, view=view)
    _draw_gates(canvas, view, ground, style, lit, on_deck=False)
    canvas.path(ground.sides, wall, view=view)
    for left, right in ground.decks:
        canvas.path(closed([np.vstack([left, right[::-1]])]), fill=theme.road, view=view)
    if ground.decks:
        _draw_gates(canvas, view, ground, style, lit, on_deck=True)
    for side in [side for deck in ground.decks for side in deck]:
        canvas.path(Outline(side), wall, view=view)


def light_gates(canvas: Canvas, view: View, ground: Ground, style: Style, lit: Collection[int]) -> None:
    """Draws some gates so that they stand out, over everything else."""
    for gate in lit:
        canvas.line(view.places(ground.gates[gate]), style.next_gate.stroke(style.theme.next_gate, view))


def number_gates(canvas: Canvas, view: View, gates: Floats, size: float, most: int, colour: str) -> None:
    """Numbers beside the left ends of the gates [G, 2, 2], of so many at most, that are seen; the last is the start."""
    ends = view.places(gates)
    outwards = ends[:, 0] - ends[:, 1]
    places = ends[:, 0] + 1.1 * size * outwards / np.maximum(1e-9, np.linalg.norm(outwards, axis=1))[:, None]
    every = round(round_number(max(1.0, len(gates) / most)))
    for gate in np.flatnonzero(view.area.inset(0.8 * size).holds(places)).tolist():
        if gate == len(gates) - 1 or gate % every == every - 1:
            name = "start" if gate == len(gates) - 1 else str(gate + 1)
            canvas.text(places[gate], name, size, colour, anchor="mm")


def draw_route(canvas: Canvas, view: View, ground: Ground, stroke: Stroke) -> None:
    """Draws the centreline alone, for a map too small to show a road, and the start across it."""
    canvas.path(closed([ground.centreline]), stroke, view=view)
    canvas.line(_start_ends(view, ground.gates[-1])[0], stroke)


def draw_scale_bar(
    canvas: Canvas, view: View, left: float, bottom: float, style: Style, least: float = 50, size: float = 15
) -> float:
    """A bar of a round number of metres, at least so many units long, with its length above it; returns its end."""
    metres = round_number(least / view.scale)
    right, tick = left + metres * view.scale, size / 3
    bar = [(left, bottom - tick), (left, bottom), (right, bottom), (right, bottom - tick)]
    canvas.line(bar, Stroke(style.theme.ink, size / 9))
    place = (left + right) / 2, bottom - size / 2
    canvas.text(place, f"{metres:,g} m", size, style.theme.ink, anchor="ms")
    return right


def draw_line(
    canvas: Canvas, view: View, pieces: Floats, colours: NDArray[np.integer], palette: Sequence[str], width: float
) -> None:
    """Draws pieces of a line, both ends of each, [N, 2, 2], m, in colours of the palette, [N]."""
    for index in np.unique(colours):
        canvas.path(segments(pieces[colours == index]), Stroke(palette[index], width, cap="butt"), view=view)


def draw_cross(canvas: Canvas, place: Floats, reach: float, colour: str) -> None:
    """Marks a collision, with a rim that makes it stand out."""
    arms = place + reach * np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]])
    canvas.segments(arms, Stroke(PAPER, reach))
    canvas.segments(arms, Stroke(colour, 0.55 * reach))


def _deck(track: "Track", over: tuple[float, float]) -> tuple[Floats, Floats]:
    """Both walls of a stretch of road."""
    from carrl.tracks.bridges import on_stretch

    points = track.centreline.numpy().astype(np.float64)
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    middles = steps.cumsum() - steps / 2
    pieces = np.flatnonzero(on_stretch(middles, over, track.length))
    pieces = pieces[np.argsort((middles[pieces] - over[0]) % track.length)]
    ends = np.append(pieces, (pieces[-1] + 1) % len(points))
    return track.left_wall.numpy()[ends].astype(np.float64), track.right_wall.numpy()[ends].astype(np.float64)


def _draw_gates(
    canvas: Canvas, view: View, ground: Ground, style: Style, lit: Collection[int], *, on_deck: bool
) -> None:
    lines = ground.gate_lines[on_deck]
    if (ground.on_deck == on_deck).any():
        canvas.path(lines, style.gate.stroke(style.theme.gate, view), view=view)
    if ground.on_deck[-1] == on_deck:
        _draw_start(canvas, view, ground.gates[-1], style.theme)
    for gate in lit:
        if ground.on_deck[gate] == on_deck:
            canvas.line(view.places(ground.gates[gate]), style.next_gate.stroke(style.theme.next_gate, view))


def _draw_start(canvas: Canvas, view: View, gate: Floats, theme: Theme) -> None:
    """Two rows of dark and light squares along a gate [2, 2], m; on a small map a line that is wider than the road."""
    ends, length = _start_ends(view, gate)
    if not view.area.inset(-length).holds(ends).any():
        return
    if length == LEAST_START:
        canvas.line(ends, Stroke(theme.ink, 2))
        return
    count = max(2, round(length / max(SQUARE * view.scale, LEAST_SQUARE)))
    across = (ends[1] - ends[0]) / count
    forward = np.array([across[1], -across[0]])
    corners = np.array([[0, -1], [count, -1], [count, 1], [0, 1]]) @ np.stack([across, forward])
    canvas.area([ends[0] + corners], theme.start_dark)
    square = np.stack([0 * across, across, across + forward, forward])
    light = [(row, column) for row in (-1, 0) for column in range(count) if (row + column) % 2]
    canvas.area([ends[0] + column * across + row * forward + square for row, column in light], theme.start)


def _start_ends(view: View, gate: Floats) -> tuple[Floats, float]:
    """Both ends of the start line in the picture, [2, 2], not too near to each other to be seen, and its length."""
    ends = view.places(gate)
    length = max(float(np.linalg.norm(ends[1] - ends[0])), 1e-9)
    reach, middle = max(length, LEAST_START), ends.mean(axis=0)
    return middle + reach / length * (ends - middle), reach
