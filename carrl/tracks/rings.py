"""Closed lines around the free space of a picture, and what lies on them.

Shapes: `H`, `W` rows and columns of a picture, row 0 at the bottom; `N` points of a ring; `E` edges; `P` rays. Lengths
are in pixels; the middle of a pixel is at its column and row, plus one half each.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from scipy import ndimage
from scipy.spatial import KDTree
from shapely import STRtree

from carrl.errors import TrackError

MOST_EDGES = 300_000
"""Between the free pixels of a corridor and others."""
SMOOTHING = 0.5
"""How far a ring's points may be moved from the edges between pixels in order to be smooth, pixels."""
MOST_ISLANDS, MOST_PIECES = 128, 200_000
_ORNAMENT = 0.05
"""A closed corridor smaller than this share of the largest one is none, but the inside of a letter, say."""
_ON_RIM = 0.1
"""Share of the picture's edge that a road may touch."""
_BLOCKS = 16
"""Of a picture, of which one at a time is counted, which takes eight times its memory."""
_PASSAGE = 0.25
"""A way around a hole that is narrower than this share of the road's greatest width is none."""
_EAST, _NORTH, _WEST, _SOUTH = range(4)
_WAY = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
_FEWEST_SMOOTHED = 16


class CorridorError(TrackError):
    """Free space that is not one closed corridor, with what it is instead, for a picture of it.

    Attributes:
        rings: the closed lines in question, [N, 2] each.
        place: what the message speaks of, [2], or None.
        free: which pixels a car may be on, [H, W], bool, or None.
    """

    def __init__(
        self,
        message: str,
        rings: Sequence[np.ndarray] = (),
        place: np.ndarray | None = None,
        free: np.ndarray | None = None,
    ) -> None:
        super().__init__(message)
        self.rings, self.place, self.free = rings, place, free


def find_loop(free: np.ndarray, occupancy: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """The rings around the corridor, around what it encloses, and around each island in it.

    Raises:
        CorridorError: as `find_corridor` does.
    """
    labels, count = ndimage.label(free)
    if count > MOST_PIECES:
        raise CorridorError(f"its free space is in {count:,} pieces; clean the picture of specks")
    sizes = np.zeros(count + 1, dtype=np.int64)
    for block in np.array_split(labels, _BLOCKS):
        sizes += np.bincount(block.ravel(), minlength=count + 1)
    rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    on_rim = np.bincount(rim, minlength=count + 1)
    sizes[0] = 0
    loops = _loops_among(labels, np.where(on_rim == 0, sizes, 0), occupancy)
    if not loops:  # then one that touches the picture's edge here and there, but is not all that lies outside
        loops = _loops_among(labels, np.where(on_rim <= _ON_RIM * len(rim), sizes, 0), occupancy)
    if not loops:
        raise CorridorError(
            "no closed corridor: no free space inside the picture leads around something that is larger than the "
            "corridor is wide; draw both walls of the whole lap, and keep the road off the picture's edge"
        )
    if len(loops) > 1:
        sizes_of = " and ".join(f"{size:,}" for size, _ in loops)
        raise CorridorError(
            f"{len(loops)} closed corridors, of {sizes_of} free pixels; fill all but one of them",
            [ring for _, rings in loops for ring in rings[:2]],
        )
    rings = loops[0][1]
    around = _loops_of(rings)
    islands = [ring for index, ring in enumerate(rings[1:], start=1) if index not in around[:1]]
    if len(islands) > MOST_ISLANDS:
        raise CorridorError(
            f"{len(islands)} islands in the road; clean the picture of specks, {MOST_ISLANDS} at the most", rings
        )
    if len(around) > 1:
        place = rings[around[1]].mean(axis=0)
        raise CorridorError(
            f"the corridor forks and has {len(around)} loops, one of them around {pixel_of(place)}; "
            "fill the way that is not to be driven",
            [rings[0], *(rings[index] for index in around)],
            place,
        )
    return rings[0], rings[around[0]], islands


def _loops_among(
    labels: np.ndarray, sizes: np.ndarray, occupancy: np.ndarray | None
) -> list[tuple[int, list[np.ndarray]]]:
    """The size and the rings of each large piece of free space that is a loop, of those that have a size here."""
    loops: list[tuple[int, list[np.ndarray]]] = []
    for label in np.argsort(-sizes)[:8]:
        if sizes[label] < max(8, _ORNAMENT * max((size for size, _ in loops), default=0)):
            break
        rows, columns = _bounds(labels, int(label))
        part = np.pad(labels[rows, columns] == label, 1)
        shades = None if occupancy is None else np.pad(occupancy[rows, columns], 1, constant_values=255)
        rings = trace(part, shades)
        if _loops_of(rings):
            corner = np.array([columns.start - 1, rows.start - 1])
            loops.append((int(sizes[label]), [ring + corner for ring in rings]))
    return loops


def _bounds(labels: np.ndarray, label: int) -> tuple[slice, slice]:
    """The rows and columns in which a piece of free space lies."""
    rows = np.flatnonzero([(row == label).any() for row in labels])
    low, high = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero((labels[low:high] == label).any(axis=0))
    return slice(low, high), slice(int(columns[0]), int(columns[-1]) + 1)


def _loops_of(rings: list[np.ndarray]) -> list[int]:
    """Which rings a road leads around: the outer one is the first, and the others are holes, the largest first.

    A hole that is no longer than the road is wide, or that leaves hardly any room on one side, is an island in it.
    """
    if len(rings) == 1:
        return []
    outer, holes = rings[0], rings[1:]
    width = float(KDTree(np.concatenate(holes)).query(outer)[0].max())
    long = [index for index, hole in enumerate(holes, start=1) if np.ptp(hole, axis=0).max() > width]
    walls = KDTree(np.concatenate([outer, *(rings[index] for index in long[:1])]))
    return long[:1] + [index for index in long[1:] if walls.query(rings[index])[0].min() > _PASSAGE * width]


def pixel_of(point: np.ndarray) -> str:
    """A place [2] in the picture, in words."""
    return f"column {point[0]:.0f}, row {point[1]:.0f} from the bottom"


def trace(free: np.ndarray, occupancy: np.ndarray | None) -> list[np.ndarray]:
    """The rings around the free pixels, which are on their left: the outer one first, then holes, the largest first.

    Args:
        free: which pixels are free, connected by their sides; none on the rim of the picture, [H, W], bool.
        occupancy: 0 for free to 255 for occupied, [H, W], where grey pixels are partly covered; None where not.

    Returns:
        Points on the edges between pixels, about a pixel apart, [N, 2] each.

    Raises:
        CorridorError: there are too many edges.
    """
    begin, way = _edges(free)
    middle = begin + _WAY[way] / 2
    if occupancy is not None:
        middle = middle - _WAY[(way + 1) % 4] * _coverage(begin, way, occupancy)[:, None]
    rings = [_smooth(middle[ring]) for ring in _chains(begin, way, free.shape[1] + 1)]
    return sorted(rings, key=lambda ring: -signed_area(ring) if signed_area(ring) > 0 else 1 / (1 - signed_area(ring)))


def _edges(free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges with a free pixel on the left and another on the right: where each begins, [E, 2], and its way, [E]."""
    inner, parts = free[1:-1, 1:-1], []
    beside = {_EAST: free[:-2, 1:-1], _NORTH: free[1:-1, 2:], _WEST: free[2:, 1:-1], _SOUTH: free[1:-1, :-2]}
    corner = {_EAST: (0, 0), _NORTH: (1, 0), _WEST: (1, 1), _SOUTH: (0, 1)}
    if sum(np.count_nonzero(inner & ~other) for other in beside.values()) > MOST_EDGES:
        raise CorridorError(f"its free space has more than {MOST_EDGES:,} edges; clean the picture of specks")
    for way, other in beside.items():
        row, column = np.nonzero(inner & ~other)
        begin = np.stack([column, row], axis=1) + 1 + np.array(corner[way])
        parts.append((begin, np.full(len(begin), way)))
    begin, ways = (np.concatenate(each) for each in zip(*parts, strict=True))
    return begin, ways


def _coverage(begin: np.ndarray, way: np.ndarray, occupancy: np.ndarray) -> np.ndarray:
    """How far the true edge lies outside of each edge between pixels, [E], by how much grey there is on both sides."""
    outward = _WAY[(way + 3) % 4]
    inside = np.floor(begin + _WAY[way] / 2 - outward / 2).astype(int)

    def value(steps: int) -> np.ndarray:
        column, row = (inside + steps * outward).T
        height, width = occupancy.shape
        return np.asarray(occupancy[row.clip(0, height - 1), column.clip(0, width - 1)] / 255)

    outside, beyond = value(1), value(2)
    return np.where(beyond > outside, 1 - outside, 0) - value(0).clip(0, 0.5)


def _chains(begin: np.ndarray, way: np.ndarray, columns: int) -> list[np.ndarray]:
    """Indices of the edges of each ring, in order. Where two pixels touch by corners only, they are kept apart."""
    key = (begin[:, 1] * columns + begin[:, 0]) * 4 + way
    order = np.argsort(key)
    sorted_key, end = key[order], begin + _WAY[way]
    follower = np.full(len(key), -1)
    for turn in (3, 0, 1):  # to the left last, which is preferred
        wanted = (end[:, 1] * columns + end[:, 0]) * 4 + (way + turn) % 4
        place = np.searchsorted(sorted_key, wanted).clip(0, len(key) - 1)
        found = sorted_key[place] == wanted
        follower[found] = order[place[found]]
    following, seen, chains = follower.tolist(), bytearray(len(key)), []
    for first in range(len(key)):
        chain, at = [], first
        while not seen[at]:
            seen[at] = 1
            chain.append(at)
            at = following[at]
        if chain:
            chains.append(np.array(chain))
    return chains


def _smooth(ring: np.ndarray) -> np.ndarray:
    """The ring [N, 2] without the steps of pixels, moved by at most `SMOOTHING`."""
    if len(ring) < _FEWEST_SMOOTHED:
        return ring
    moved = ndimage.gaussian_filter1d(ring, 2.0, axis=0, mode="wrap") - ring
    far = np.linalg.norm(moved, axis=1, keepdims=True) / SMOOTHING
    return np.asarray(ring + moved / np.maximum(far, 1))


def signed_area(ring: np.ndarray) -> float:
    """Of the ring [N, 2], positive where it is counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def resampled(ring: np.ndarray, step: float) -> np.ndarray:
    """Points evenly spaced along the closed line [N, 2], from its first point on, about `step` apart."""
    along = arc_lengths(ring)
    count = max(8, round(along[-1] / step))
    return point_at(ring, np.arange(count) * along[-1] / count)


def arc_lengths(ring: np.ndarray) -> np.ndarray:
    """How far each point is along the closed line, and last its length, [N + 1]."""
    return np.concatenate([[0], np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).cumsum()])


def point_at(ring: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The points [P, 2] at places along the closed line [N, 2], which may be more than once around, [P]."""
    along, closed = arc_lengths(ring), np.vstack([ring, ring[:1]])
    places = places % along[-1]
    return np.stack([np.interp(places, along, column) for column in closed.T], axis=1)


def cast(origins: np.ndarray, rays: np.ndarray, ring: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays first meet a closed line.

    Args:
        origins: where they begin, [P, 2].
        rays: to where they reach, from there, [P, 2].
        ring: [N, 2].

    Returns:
        The share of each ray before it meets the line, infinite where it does not, [P], and the place along the line,
        [P].
    """
    ends, along = np.roll(ring, -1, axis=0), arc_lengths(ring)
    tree = STRtree(np.asarray(shapely.linestrings(np.stack([ring, ends], axis=1))))
    lines = np.asarray(shapely.linestrings(np.stack([origins, origins + rays], axis=1)))
    row, piece = tree.query(lines)
    way, away, ray = (ends - ring)[piece], ring[piece] - origins[row], rays[row]
    area = ray[:, 0] * way[:, 1] - ray[:, 1] * way[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (away[:, 0] * way[:, 1] - away[:, 1] * way[:, 0]) / area
        part = (away[:, 0] * ray[:, 1] - away[:, 1] * ray[:, 0]) / area
    meets = (share >= 0) & (share <= 1) & (part >= -1e-9) & (part <= 1 + 1e-9)
    row, piece, share, part = row[meets], piece[meets], share[meets], part[meets]
    nearest = np.lexsort((share, row))
    row, first = np.unique(row[nearest], return_index=True)
    chosen = nearest[first]
    shares, places = np.full(len(origins), np.inf), np.zeros(len(origins))
    shares[row] = share[chosen]
    places[row] = along[piece[chosen]] + part[chosen] * np.diff(along)[piece[chosen]]
    return shares, places


def thinned(lines: np.ndarray, tolerance: float) -> np.ndarray:
    """Which points of several closed lines are needed for all of them to stay within a tolerance.

    Source: Douglas and Peucker (1973), for lines that are followed in step; the first points are kept.

    Args:
        lines: K lines of as many points, [P, K, 2].
        tolerance: how far the points left out may be from the lines that remain.

    Returns:
        Increasing indices.
    """
    count = len(lines)
    closed = np.concatenate([lines, lines[:1]])
    kept, spans = {0}, [(0, count // 2), (count // 2, count)]
    while spans:
        first, last = spans.pop()
        kept.add(first)
        if last - first < 2:
            continue
        begin, way = closed[first], closed[last] - closed[first]
        away = closed[first + 1 : last] - begin
        share = (away * way).sum(axis=2) / np.maximum((way**2).sum(axis=1), 1e-12)
        off = np.linalg.norm(away - share.clip(0, 1)[:, :, None] * way, axis=2).max(axis=1)
        worst = int(off.argmax())
        if off[worst] > tolerance:
            spans += [(first, first + 1 + worst), (first + 1 + worst, last)]
    return np.array(sorted(kept))
