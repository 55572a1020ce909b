"""Random circuits: the outline of a random shape on a grid, bent, turned and rounded.

A shape grows cell by cell; thin arms of it make hairpins, steps make chicanes, long edges make straights. Its corners
are moved at random and then rounded by arcs that join the straights smoothly, so the centreline has exactly the least
radius and the length that were wished.

Shapes: `N` corners, `P` points. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from carrl.errors import TrackError
from carrl.tracks.centreline import Centreline

CORNER_RADIUS = (8.0, 20.0)
WIDTH = (6.0, 12.0)
LENGTH = (200.0, 800.0)
CORNER_SPACING = (1.5, 3.0)
RADIUS_MARGIN = 1.0
"""The least radius of the centreline exceeds half the width by this, so that the inner wall has a radius, too, m."""
LENGTH_PER_RADIUS = 10.0
"""The shortest circuit per least radius; a circle has 2 pi."""
LARGEST = 1e4
"""No radius, width or length may exceed this, m."""
POINT_SPACING = 2.0
MOST_WIDENING = 5.0
"""The largest share by which either half of a road may be wider in places than where it is narrowest."""
SHORTEST_SWELL = 80.0
"""Length of the shortest of the waves that make up a road's changes of width, m."""
MOST_DRAWS = 1000
"""How many circuits are drawn until one fits."""

Cell = tuple[int, int]
Range = float | Sequence[float]

_NEIGHBOURS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""Around a cell; the even ones share an edge with it."""


@dataclass(frozen=True)
class Measures:
    """What a circuit is to measure, m."""

    corner_radius: float
    width: float
    length: float


def random_centrelines(
    seed: int,
    corner_radius: Range,
    width: Range,
    length: Range,
    widening: float = 0.0,
    corner_spacing: Range = CORNER_SPACING,
    hairpins: float = 0.0,
) -> Iterator[Centreline]:
    """Circuits of the same measures, drawn from one seed, as long as one is asked for; a few have legs that overlap.

    Args:
        seed: a whole number from 0 on.
        corner_radius: see `Measures`, as for `width` and `length`.
        width: where the road is narrowest.
        length: of the centreline.
        widening: how much wider either half of the road may be in places, as a share of itself.
        corner_spacing: about how far corners stand apart, in least radii.
        hairpins: share of the narrow U-turns that are one acute corner instead of two right-angled ones.

    Raises:
        TrackError: a value is no number or range, or no circuit has these measures.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise TrackError(f"a random track: seed is {seed!r}; it must be a whole number from 0 on")
    random = np.random.default_rng(seed)
    for name, share, most in (("widening", widening, MOST_WIDENING), ("hairpins", hairpins, 1.0)):
        if isinstance(share, bool) or not 0 <= share <= most:
            raise TrackError(f"a random track: {name} is {share!r}; it must be a share between 0 and {most:g}")
    measures = _draw_measures(random, corner_radius, width, length)
    spacing = _as_range("corner_spacing", corner_spacing, "least radii")
    half_width = measures.width / 2
    for _ in range(MOST_DRAWS):
        points = _round_corners(random, _draw_corners(random, measures, spacing, hairpins), measures)
        if points is not None:
            right, left = (half_width * (1 + widening * _draw_swell(random, len(points), widening)) for _ in range(2))
            yield Centreline(points, width_right=right, width_left=left)


def _draw_swell(random: np.random.Generator, count: int, widening: float) -> np.ndarray:
    """How much of its widening the road has at each of so many points, [P], in 0..1; smooth, and 0 for half of them.

    Draws nothing where nothing is widened, so that the circuits of a seed stay as they are.
    """
    if widening == 0:
        return np.zeros(count)
    along = 2 * math.pi * np.arange(count) / count
    waves = np.arange(1, max(2, round(count * POINT_SPACING / SHORTEST_SWELL) + 1))
    sizes, phases = random.standard_normal(len(waves)), random.uniform(0, 2 * math.pi, len(waves))
    swell = (sizes[:, None] * np.sin(waves[:, None] * along + phases[:, None])).sum(axis=0)
    return np.asarray(np.maximum(swell, 0) / max(float(swell.max()), 1e-12))


def _draw_measures(random: np.random.Generator, corner_radius: Range, width: Range, length: Range) -> Measures:
    """Draws each measure from the part of its range that leaves room for the others."""
    radii, widths, lengths = (
        _as_range(name, value)
        for name, value in (("corner_radius", corner_radius), ("width", width), ("length", length))
    )
    tightest = max(radii[0], widths[0] / 2 + RADIUS_MARGIN)
    if radii[1] < tightest:
        raise TrackError(
            f"a random track: corner_radius is at most {radii[1]:g} m; for a width of {widths[0]:g} m it must be at "
            f"least {tightest:g} m, half the width and {RADIUS_MARGIN:g} m"
        )
    if lengths[1] < tightest * LENGTH_PER_RADIUS:
        raise TrackError(
            f"a random track: length is at most {lengths[1]:g} m; with a corner_radius of {tightest:g} m it must be "
            f"at least {tightest * LENGTH_PER_RADIUS:g} m"
        )
    drawn_length = random.uniform(max(lengths[0], tightest * LENGTH_PER_RADIUS), lengths[1])
    widest_radius = min(radii[1], drawn_length / LENGTH_PER_RADIUS)
    drawn_width = random.uniform(widths[0], max(widths[0], min(widths[1], 2 * (widest_radius - RADIUS_MARGIN))))
    drawn_radius = random.uniform(max(radii[0], drawn_width / 2 + RADIUS_MARGIN), widest_radius)
    return Measures(drawn_radius, drawn_width, drawn_length)


def _as_range(name: str, value: Range, unit: str = "metres") -> tuple[float, float]:
    ends = value if isinstance(value, Sequence) and not isinstance(value, str) else (value, value)
    numbers = all(isinstance(end, int | float) and not isinstance(end, bool) for end in ends)
    if len(ends) != 2 or not numbers or not 0 < ends[0] <= ends[1] <= LARGEST:
        raise TrackError(
            f"a random track: {name} is {value!r}; it must be a number of {unit} or a range [low, high], "
            f"positive and at most {LARGEST:g}"
        )
    return float(ends[0]), float(ends[1])


def _draw_corners(
    random: np.random.Generator, measures: Measures, spacing: tuple[float, float], hairpins: float
) -> np.ndarray:
    """Corners [N, 2] of a polygon in the unit of a cell, turned, stretched and, for half of them, clockwise."""
    cell_size = measures.corner_radius * random.uniform(*spacing)
    cells = _grow_shape(random, max(1, min(200, round(measures.length / cell_size / 2 - 1))))
    outline = np.array(_outline(cells), dtype=np.float64)
    ways = np.roll(outline, -1, axis=0) - outline
    bends = (ways != np.roll(ways, 1, axis=0)).any(axis=1)
    outline = outline[bends | (random.random(len(outline)) < random.uniform(0, 0.5))]
    if hairpins:
        outline = _join_u_turns(random, outline, hairpins)
    outline += random.uniform(-1, 1, outline.shape) * random.uniform(0.1, 0.35)
    stretch, angle = random.uniform(1.0, 1.8), random.uniform(0, 2 * math.pi)
    cos, sin = math.cos(angle), math.sin(angle)
    corners = (outline * [stretch, 1.0]) @ [[cos, sin], [-sin, cos]]
    return corners[::-1] if random.random() < 0.5 else corners


def _join_u_turns(random: np.random.Generator, corners: np.ndarray, share: float) -> np.ndarray:
    """Corners [M, 2] in which one acute corner takes the place of some pairs that stand a cell apart and turn alike.

    Joins none where fewer than three corners would be left.
    """
    following = np.roll(corners, -1, axis=0)
    (x, y), (after_x, after_y) = (corners - np.roll(corners, 1, axis=0)).T, (following - corners).T
    turns = np.sign(x * after_y - y * after_x)
    is_u_turn = (np.hypot(after_x, after_y) == 1) & (turns * np.roll(turns, -1) == 1)
    joined = is_u_turn & (random.random(len(corners)) < share)
    joined[1:] &= ~joined[:-1]
    joined[-1] = False
    if len(corners) - joined.sum() < 3:
        return corners
    ends = np.roll(joined, 1)
    return np.where(joined[:, None], (corners + following) / 2, corners)[~ends]


def _grow_shape(random: np.random.Generator, count: int) -> set[Cell]:
    """A connected shape of cells without holes, whose outline never touches itself."""
    shape, latest, thin = [(0, 0)], random.uniform(0, 0.9), random.uniform(0.5, 1)
    cells = set(shape)
    while len(cells) < count:
        base = shape[-1] if random.random() < latest else shape[random.integers(len(shape))]
        step = _NEIGHBOURS[2 * random.integers(4)]
        cell = (base[0] + step[0], base[1] + step[1])
        around = [(cell[0] + x, cell[1] + y) in cells for x, y in _NEIGHBOURS]
        if cell in cells or not _in_one_piece(around) or (sum(around[::2]) > 1 and random.random() < thin):
            continue
        cells.add(cell)
        shape.append(cell)
    return cells


def _in_one_piece(around: list[bool]) -> bool:
    """Whether the shape's cells around a new one follow on each other, so that adding it closes no ring."""
    return sum(here and not before for here, before in zip(around, [around[-1], *around[:-1]], strict=True)) == 1


def _outline(cells: set[Cell]) -> list[Cell]:
    """The grid points around a shape, counter-clockwise."""
    following: dict[Cell, Cell] = {}
    for x, y in cells:
        ring = ((x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1))
        for side, (dx, dy) in enumerate(((0, -1), (1, 0), (0, 1), (-1, 0))):
            if (x + dx, y + dy) not in cells:
                following[ring[side]] = ring[(side + 1) % 4]
    outline = [next(iter(following))]
    while len(outline) < len(following):
        outline.append(following[outline[-1]])
    return outline


def _round_corners(random: np.random.Generator, corners: np.ndarray, measures: Measures) -> np.ndarray | None:
    """The polygon, scaled and rounded, as evenly spaced points [P, 2]; None where its corners do not fit.

    A corner that turns by `turn` and is rounded from `tangent` before it to `tangent` behind it has the radius
    tangent / tan(turn / 2).
    """
    edges = np.roll(corners, -1, axis=0) - corners
    lengths, headings = np.linalg.norm(edges, axis=1), np.arctan2(edges[:, 1], edges[:, 0])
    turns = (headings - np.roll(headings, 1) + math.pi) % (2 * math.pi) - math.pi
    slope = np.tan(np.abs(turns) / 2)
    least = measures.corner_radius * slope
    share = random.random(len(corners)) ** 2
    share[random.integers(len(corners))] = 0.0  # one corner has the least radius
    saved = 2 - np.abs(turns) / np.maximum(slope, 1e-12)  # by an arc instead of the corner, per tangent
    scale, tangents = 0.0, least
    for _ in range(8):  # Each round leaves about a fifth of the error.
        scale = (measures.length + (saved * tangents).sum()) / lengths.sum()
        spare = scale * lengths - least - np.roll(least, -1)
        if (spare < 0).any():
            return None
        tangents = least + share * np.minimum(spare, np.roll(spare, 1)) / 2
    straights = scale * lengths - tangents - np.roll(tangents, -1)
    arcs = np.abs(turns) * tangents / np.maximum(slope, 1e-12)
    curvature = np.sign(turns) * slope / tangents
    begin = scale * corners[0] - tangents[0] * np.array([math.cos(headings[-1]), math.sin(headings[-1])])
    return _sample(begin, headings, turns, arcs, curvature, straights)


def _sample(
    begin: np.ndarray,
    headings: np.ndarray,
    turns: np.ndarray,
    arcs: np.ndarray,
    curvature: np.ndarray,
    straights: np.ndarray,
) -> np.ndarray:
    """Evenly spaced points [P, 2] of a line of arcs and straights by turns, from the middle of the longest straight.

    Args:
        begin: of the first arc, [2], m.
        headings: after each arc, [N], rad.
        turns: of each arc, [N], rad, positive to the left.
        arcs: their lengths, [N], m.
        curvature: of each arc, [N], 1/m, positive to the left.
        straights: length of the straight after each arc, [N], m.
    """
    count = 2 * len(arcs)
    piece_length, heading, bend = np.empty(count), np.empty(count), np.zeros(count)
    piece_length[::2], piece_length[1::2] = arcs, straights
    heading[::2], heading[1::2] = headings - turns, headings
    bend[::2] = curvature
    stations = np.concatenate([[0], piece_length.cumsum()])
    longest = 2 * int(straights.argmax()) + 1
    points = math.ceil(stations[-1] / POINT_SPACING)
    along = (stations[longest] + piece_length[longest] / 2 + np.arange(points) * stations[-1] / points) % stations[-1]
    piece = np.clip(np.searchsorted(stations, along, side="right") - 1, 0, count - 1)
    starts = begin + np.vstack([[0, 0], _chords(piece_length, heading, bend)[:-1].cumsum(axis=0)])
    return np.asarray(starts[piece] + _chords(along - stations[piece], heading[piece], bend[piece]))


def _chords(length: np.ndarray, heading: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """From the begin to the end of an arc, or a straight, of this length: [K], [K], [K] to [K, 2], m."""
    half_turn = curvature * length / 2
    chord = length * np.sinc(half_turn / math.pi)
    return np.stack([chord * np.cos(heading + half_turn), chord * np.sin(heading + half_turn)], axis=1)
