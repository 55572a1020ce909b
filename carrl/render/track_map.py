"""A map of a track: the road between its walls, numbered gates, the start and the driving direction, a scale bar.

Shapes: `P` points of the centreline, `G` gates, `K` any points. Lengths on the track are in metres, on the paper in
points (1/72 inch). Tracks of 100 m and of 7 km are drawn alike: widths and offsets are set on the paper.
"""

import math
import textwrap
from dataclasses import dataclass

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from carrl.printable import printable
from carrl.render.figure import GATE, INK, ROAD, WALL, WIDTH, new_figure
from carrl.tracks.bridges import Bridge, on_stretch
from carrl.tracks.track import Track

Floats = NDArray[np.floating]

MOST_GATE_NUMBERS = 24
MARGIN, HEAD, FOOT, TALLEST = 32.0, 14.0, 24.0, 430.0
"""Room for labels around the road, for the title and for the legend, and the most height of the road itself; points."""


@dataclass(frozen=True)
class TrackMap:
    """A figure that is a map from edge to edge.

    Attributes:
        figure: to be saved.
        axes: in metres, with equal aspect, as large as the figure.
        scale: points per metre.
    """

    figure: Figure
    axes: Axes
    scale: float

    def width(self, metres: float, least: float, most: float) -> float:
        """A width on the track as one on the paper, points, kept between two bounds."""
        return float(np.clip(metres * self.scale, least, most))

    @property
    def frame(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of the part between title and legend, m."""
        (left, right), (bottom, top) = self.axes.get_xlim(), self.axes.get_ylim()
        edge = 10 / self.scale
        return left + edge, bottom + FOOT / self.scale + edge, right - edge, top - HEAD / self.scale - edge


def draw_track_map(track: Track, title: str) -> TrackMap:
    """A new map of the track, with a strip free below it for a legend."""
    walls = track.walls.numpy().reshape(-1, 2).astype(np.float64)
    track_map = _blank_map(walls.min(axis=0), walls.max(axis=0))
    axes = track_map.axes
    draw_road(track_map, track)
    draw_gates(track_map, track)
    _number_gates(track_map, track, covered=_draw_start(track_map, track))
    _draw_scale_bar(track_map)
    heading = textwrap.fill(printable(title), 100, max_lines=2, placeholder="...")
    top = (sum(axes.get_xlim()) / 2, axes.get_ylim()[1] - 8 / track_map.scale)
    axes.text(*top, heading, ha="center", va="top", fontsize=10.5, color=INK, parse_math=False, zorder=9)
    return track_map


def _blank_map(low: Floats, high: Floats) -> TrackMap:
    """An empty map of the rectangle between two corners, m, as large as the common width and TALLEST allow."""
    size = high - low
    paper_width = WIDTH * 72
    scale = float(min((paper_width - 2 * MARGIN) / size[0], TALLEST / size[1]))
    paper_height = size[1] * scale + HEAD + FOOT + 2 * MARGIN
    figure = new_figure(paper_height / 72, constrained=False)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    left = (low[0] + high[0] - paper_width / scale) / 2
    bottom = low[1] - (FOOT + MARGIN) / scale
    axes.set_xlim(left, left + paper_width / scale)
    axes.set_ylim(bottom, bottom + paper_height / scale)
    return TrackMap(figure, axes, scale)


def draw_road(track_map: TrackMap, track: Track) -> None:
    """Fills the ring between the walls: one wall forwards and the other backwards leave a hole."""
    sides = track.left_wall.numpy(), track.right_wall.numpy()[::-1]
    road = Outline.make_compound_path(*(Outline(np.vstack([side, side[:1]]), closed=True) for side in sides))
    width = track_map.width(0.25, least=0.4, most=1.2)
    track_map.axes.add_patch(PathPatch(road, facecolor=ROAD, edgecolor="none", zorder=1))
    track_map.axes.add_patch(PathPatch(road, facecolor="none", edgecolor=WALL, linewidth=width, zorder=3))
    for bridge in track.bridges:
        _draw_bridge(track_map.axes, track, bridge, width)


def _draw_bridge(axes: Axes, track: Track, bridge: Bridge, width: float) -> None:
    """The stretch of road that is over, drawn once more on top of the walls of the one that is under."""
    points = track.centreline.numpy().astype(np.float64)
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    middles = steps.cumsum() - steps / 2
    segments = np.flatnonzero(on_stretch(middles, bridge.over, track.length))
    segments = segments[np.argsort((middles[segments] - bridge.over[0]) % track.length)]
    ends = np.append(segments, (segments[-1] + 1) % len(points))
    left, right = track.left_wall.numpy()[ends], track.right_wall.numpy()[ends]
    axes.add_patch(PathPatch(Outline(np.vstack([left, right[::-1]])), facecolor=ROAD, edgecolor="none", zorder=3.1))
    for side in (left, right):
        axes.plot(*side.T, color=WALL, linewidth=width, solid_capstyle="butt", zorder=3.2)


def draw_gates(track_map: TrackMap, track: Track) -> None:
    """White lines across the road."""
    width = track_map.width(0.4, least=0.5, most=2.0)
    stations = track.gate_stations.numpy()
    on_bridge = np.any([on_stretch(stations, bridge.over, track.length) for bridge in track.bridges], axis=0)
    for level, shown in ((2, ~on_bridge), (3.3, on_bridge)):
        gates = track.gates.numpy()[np.broadcast_to(shown, len(stations))]
        track_map.axes.add_collection(LineCollection(list(gates), colors=GATE, linewidths=width, zorder=level))


def _draw_start(track_map: TrackMap, track: Track) -> Floats:
    """The start line and beside it, on the roomier side, an arrow in the driving direction; returns what it covers."""
    line = track.gates[-1].numpy().astype(np.float64)
    axes, width = track_map.axes, track_map.width(0.6, least=1.2, most=3.0)
    axes.plot(*line.T, color=INK, linewidth=width, solid_capstyle="butt", zorder=3.5)
    axes.plot(*line.T, color=GATE, linewidth=width, linestyle=(0, (1.2, 1.2)), dash_capstyle="butt", zorder=3.6)
    across = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    heading = track.pose_at(torch.zeros(1))[0, 2].item()  # not square to the line where that stands in a corner
    forward = np.array([math.cos(heading), math.sin(heading)]) / track_map.scale
    # The word stands before the arrow; it is wider than high, so it needs more room where it meets something sideways.
    behind, aside = 6 + 9 * abs(across[1]), 9 + 5 * abs(across[0])
    places = _beside(track_map, line, aside)
    sides = [np.stack([place - behind * forward, place, place + 26 * forward]) for place in places]
    word, tail, head = covered = max(sides, key=lambda places: _room(track, places))
    write(axes, word, "start")
    axes.add_patch(
        FancyArrowPatch(
            tuple(tail),
            tuple(head),
            arrowstyle="-|>",
            mutation_scale=9,
            shrinkA=0,
            shrinkB=0,
            color=INK,
            linewidth=1.2,
            zorder=8,
        )
    )
    return covered


def _number_gates(track_map: TrackMap, track: Track, covered: Floats) -> None:
    """Numbers outside the road where there is more room, but none on the places [K, 2]; the last gate is the start."""
    gates = track.gates.numpy().astype(np.float64)
    every = round(round_number(max(1.0, len(gates) / MOST_GATE_NUMBERS)))
    for index in range(every - 1, len(gates) - 1, every):
        place = max(_beside(track_map, gates[index]), key=lambda place: _room(track, place[None]))
        if np.linalg.norm(covered - place, axis=1).min() * track_map.scale > 20:
            write(track_map.axes, place, str(index + 1))
            covered = np.vstack([covered, place])


def _draw_scale_bar(track_map: TrackMap) -> None:
    """A bar of a round number of metres at the lower left."""
    length = round_number(35 / track_map.scale)
    left = track_map.axes.get_xlim()[0] + 14 / track_map.scale
    bottom = track_map.axes.get_ylim()[0] + 14 / track_map.scale
    tick = 2.5 / track_map.scale
    x = [left, left, left, left + length, left + length, left + length]
    y = [bottom + tick, bottom - tick, bottom, bottom, bottom - tick, bottom + tick]
    track_map.axes.plot(x, y, color=INK, linewidth=1, zorder=8)
    write(track_map.axes, np.array([left + length / 2, bottom + 8 / track_map.scale]), f"{length:,g} m")


def round_number(least: float) -> float:
    """The smallest of ..., 1, 2, 5, 10, 20, 50, ... that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(digit * power for digit in (1, 2, 5, 10) if digit * power >= least)


def _beside(track_map: TrackMap, gate: Floats, distance: float = 9.0) -> tuple[Floats, Floats]:
    """Places for a label outside both ends of a gate, [2, 2], at a distance in points: two points [2], m."""
    outwards = (gate[0] - gate[1]) / np.linalg.norm(gate[0] - gate[1]) * distance / track_map.scale
    return gate[0] + outwards, gate[1] - outwards


def _room(track: Track, places: Floats) -> float:
    """Distance from the centreline to the nearest of the places [K, 2], m."""
    return float(np.linalg.norm(track.centreline.numpy()[:, None] - places, axis=-1).min())


def write(axes: Axes, place: Floats, text: str) -> None:
    """A small label about a place [2], m, with a white rim to stand out on lines."""
    rim = [Stroke(linewidth=2.5, foreground="white"), Normal()]
    label = axes.text(place[0], place[1], text, ha="center", va="center", fontsize=8, color=INK, zorder=9)
    label.set_path_effects(rim)
