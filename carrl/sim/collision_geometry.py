"""All that cars can meet on any number of tracks: walls, gates, and which of them count where, as flat tensors.

A car sees the walls of one *deck* of its track. A track without a bridge has one deck. On others, cars on the road
that goes over see all but the walls of the road below it, and all other cars see all but the walls of the road above.
Which deck a car is on follows from the gate that it heads for.

Which walls are near a place is told by a grid of square cells, each with the list of the walls that come within reach
of any point of it: whoever looks no further than that misses nothing. Cells are a quarter of the reach wide, so that
memory grows with the number of walls and not with the reach; they are wider on a track so large that there would be
more than `MOST_CELLS`.

Shapes: `T` tracks, `K` decks of all tracks, `S` walls, `G` gates, `C` cells, `L` lists, `E` entries of all
lists, `P` pairs of a wall and a cell, `B` cars. Lengths
are in metres.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.errors import TrackError
from carrl.tracks.bridges import Stretch, on_stretch
from carrl.tracks.track import Track

CELLS_PER_REACH = 4
MOST_CELLS = 2**18
MOST_PAIRS = 10_000_000
"""Of a wall and a cell that may be near it; 70,000 walls a metre long have so many. They take about a gigabyte."""
_MARGIN = 1e-6
"""Share of the largest coordinate by which lists reach further, for the rounding of positions in float32."""


@dataclass(frozen=True)
class WallGrid:
    """The grid; a place outside of it is out of reach of all walls.

    Attributes:
        low: the corner of least x and y, [2], float64, m.
        cell_size: side of a cell, m.
        columns: cells in the direction of x.
        rows: cells in the direction of y.
        list_of_cell: which list each cell has, row by row, [C], int32; list 0 is the empty one.
        lists: where in `entries` each list begins, where its walls within touch end, and where it ends, [L, 3], int32.
        entries: indices of walls, [E], int32; an even number for each list, its last one twice if need be.
    """

    low: np.ndarray
    cell_size: float
    columns: int
    rows: int
    list_of_cell: np.ndarray
    lists: np.ndarray
    entries: np.ndarray

    @staticmethod
    def build(walls: np.ndarray, reach: float, touch: float) -> "WallGrid":
        """Lists the walls for every cell.

        Args:
            walls: [S, 2, 2], m.
            reach: how far a car sees or moves, m.
            touch: how far it touches anything in one step, m, at most `reach`; these walls come first in each list.

        Raises:
            TrackError: there are too many walls.
        """
        walls = walls.astype(np.float64)
        margin = _MARGIN * (np.abs(walls).max() + reach)
        reach, touch = reach + margin, touch + margin
        low, high = walls.min((0, 1)) - reach, walls.max((0, 1)) + reach
        cell_size = max(reach / CELLS_PER_REACH, math.sqrt((high - low).prod() / MOST_CELLS))
        shape = np.ceil((high - low) / cell_size).astype(np.int64)
        wall, cell = _pair(walls, low, cell_size, shape, reach)
        middle = low + (np.stack([cell % shape[0], cell // shape[0]], axis=1) + 0.5) * cell_size
        distance = _distances(middle, walls[wall]) - cell_size * math.sqrt(0.5)  # from the nearest point of the cell
        near = distance <= reach
        wall, cell, is_far = wall[near], cell[near], distance[near] > touch
        order = np.lexsort((wall, is_far, cell))
        wall, cell, is_far = (each[order] for each in (wall, cell, is_far))
        cells, begin, count = np.unique(cell, return_index=True, return_counts=True)
        copies = np.ones(len(wall), np.int64)
        copies[(begin + count - 1)[count % 2 == 1]] = 2
        wall, is_far = np.repeat(wall, copies), np.repeat(is_far, copies)
        count += count % 2
        begin = count.cumsum() - count
        touching = np.add.reduceat(~is_far, begin)
        list_of_cell = np.zeros(shape.prod(), np.int32)
        list_of_cell[cells] = np.arange(1, len(cells) + 1)
        lists = np.vstack([np.zeros((1, 3)), np.stack([begin, begin + touching, begin + count], axis=1)])
        return WallGrid(
            low=low,
            cell_size=cell_size,
            columns=int(shape[0]),
            rows=int(shape[1]),
            list_of_cell=list_of_cell,
            lists=lists.astype(np.int32),
            entries=wall.astype(np.int32),
        )


def _pair(
    walls: np.ndarray, low: np.ndarray, cell_size: float, shape: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Every wall with every cell of the rectangle about it that holds all within reach: wall [P] and cell [P]."""
    first = np.clip(((walls.min(1) - reach - low) // cell_size).astype(np.int64), 0, shape - 1)
    last = np.clip(((walls.max(1) + reach - low) // cell_size).astype(np.int64), 0, shape - 1)
    width, height = (last - first + 1).T
    count = width * height
    if count.sum() > MOST_PAIRS:
        raise TrackError(
            f"a track of {len(walls):,} walls is too finely drawn; leave out points, so that they stand a metre apart"
        )
    wall = np.repeat(np.arange(len(walls)), count)
    within = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
    column, row = first[wall, 0] + within % width[wall], first[wall, 1] + within // width[wall]
    return wall, row * shape[0] + column


def _distances(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """From each point [P, 2] to its own wall [P, 2, 2]: [P], m."""
    begin, edge = walls[:, 0], walls[:, 1] - walls[:, 0]
    squared_length = np.maximum((edge * edge).sum(axis=1), np.finfo(np.float64).tiny)
    share = np.clip(((points - begin) * edge).sum(axis=1) / squared_length, 0, 1)
    return np.linalg.norm(points - begin - share[:, None] * edge, axis=1)


class TrackLayout(NamedTuple):
    """The walls and gates of one track.

    Attributes:
        walls: [S, 2, 2], m.
        gates: in driving order as (left end, right end), [G, 2, 2], m.
        visible: which walls each of the track's decks has, [K, S], bool.
        deck_of_gate: the deck of a car that heads for each gate, [G], int64.
    """

    walls: Tensor
    gates: Tensor
    visible: Tensor
    deck_of_gate: Tensor

    @staticmethod
    def of_track(track: Track, reach: float) -> "TrackLayout":
        """The track's walls by deck, for cars that see as far as `reach` m.

        Raises:
            TrackError: two roads meet at a bridge so closely that the gates do not tell which one a car is on.
        """
        walls, gates = track.wall_stations.numpy(), track.gate_stations.numpy()
        above, below = np.zeros((2, len(walls)), dtype=bool)
        heads_above, heads_below = np.zeros((2, len(gates)), dtype=bool)
        for bridge in track.bridges:
            above |= on_stretch(walls, bridge.over, track.length)
            below |= on_stretch(walls, bridge.under, track.length)
            # Twice the reach, for a car may look across the inside of a bend.
            in_sight = bridge.over[0] - 2 * reach, bridge.over[1] + 2 * reach
            heads_above |= _leads_onto(gates, in_sight, track.length)
            heads_below |= _leads_onto(gates, bridge.under, track.length)
        if (heads_above & heads_below).any():
            raise TrackError(
                f"track '{track.name}': the roads at a bridge are so close along the track that the gates do not tell "
                "them apart; use a smaller gate_spacing, or a smaller sensor range"
            )
        visible = np.stack([~above, ~below] if track.bridges else [~above])
        return TrackLayout(
            track.walls, track.gates, torch.from_numpy(visible), torch.from_numpy(heads_above.astype(np.int64))
        )


class CollisionGeometry(NamedTuple):
    """The tracks side by side; all floating-point numbers are float64.

    Attributes:
        walls: x and y of both ends, [S + 1, 4], m; the first one is out of everyone's reach.
        gates: x and y of the left end and of the right end, [G, 4], m.
        first_gate: of each track, and at the end G, [T + 1], int64.
        deck_of_gate: the deck of a car that heads for each gate, [G], int64.
        corners: of each deck's grid: least x, least y, side of a cell, [K, 3], m.
        shapes: of each deck's grid: columns, rows, first cell, [K, 3], int64.
        list_of_cell: which list each cell has, [C], int32.
        lists: where in `entries` each list begins, where its walls within touch end, and where it ends, [L, 3], int32.
        entries: indices of walls, [E], int32.
    """

    walls: Tensor
    gates: Tensor
    first_gate: Tensor
    deck_of_gate: Tensor
    corners: Tensor
    shapes: Tensor
    list_of_cell: Tensor
    lists: Tensor
    entries: Tensor

    @staticmethod
    def join(plots: Sequence[TrackLayout], reach: float, touch: float) -> "CollisionGeometry":
        """Lays the plots side by side, on the CPU.

        Args:
            plots: one for each track.
            reach: how far a car sees or moves in one step, m.
            touch: how far it touches anything in one step, m, at most `reach`.
        """
        parts: dict[str, list[np.ndarray]] = {name: [_BEFORE_ALL[name]] for name in CollisionGeometry._fields}

        def size(name: str) -> int:
            return sum(map(len, parts[name]))

        for plot in plots:
            parts["deck_of_gate"].append(plot.deck_of_gate.numpy() + size("corners"))
            walls = plot.walls.double().numpy()
            for visible in plot.visible.numpy():
                index = visible.nonzero()[0]
                grid = WallGrid.build(walls[index], reach, touch)
                parts["corners"].append(np.array([[*grid.low, grid.cell_size]]))
                parts["shapes"].append(np.array([[grid.columns, grid.rows, size("list_of_cell")]]))
                lists_before = size("lists") - 1  # but for the empty one, which all grids share
                parts["list_of_cell"].append(np.where(grid.list_of_cell > 0, grid.list_of_cell + lists_before, 0))
                parts["lists"].append(grid.lists[1:] + size("entries"))
                parts["entries"].append(index[grid.entries] + size("walls"))
            parts["walls"].append(walls.reshape(-1, 4))
            parts["gates"].append(plot.gates.double().numpy().reshape(-1, 4))
            parts["first_gate"].append(np.array([size("gates")]))
        joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
        types = {name: np.int32 for name in ("list_of_cell", "lists", "entries")}
        return CollisionGeometry(
            **{name: torch.from_numpy(array.astype(types.get(name, array.dtype))) for name, array in joined.items()}
        )

    @property
    def bytes(self) -> int:
        """Memory that the tracks take."""
        return sum(tensor.nbytes for tensor in self)

    @property
    def longest_list(self) -> int:
        """Entries of the list that has most."""
        return int((self.lists[:, 2] - self.lists[:, 0]).max())

    def deck(self, track: Tensor, next_gate: Tensor) -> Tensor:
        """The deck of cars by their track [B] and the gate that they head for [B]: [B], int64."""
        return self.deck_of_gate[self.first_gate[track] + next_gate]

    def walls_near(self, position: Tensor, deck: Tensor, most: int) -> Tensor:
        """All the walls within reach of each position, and some others.

        Args:
            position: [B, 2], m.
            deck: of each car, [B], int64.
            most: how many walls to list for each, filled up with one out of reach: `longest_list`.

        Returns:
            [B, most, 2, 2], m.
        """
        corner, shape = self.corners[deck], self.shapes[deck]
        cell = ((position.double() - corner[:, :2]) / corner[:, 2:]).floor().nan_to_num(-1)
        is_inside = ((cell >= 0) & (cell < shape[:, :2])).all(dim=1)
        column, row = torch.where(is_inside[:, None], cell, 0).long().unbind(1)
        list_ = torch.where(is_inside, self.list_of_cell[shape[:, 2] + row * shape[:, 0] + column], 0)
        begin, _, end = self.lists[list_].long().unbind(1)
        entry = begin[:, None] + torch.arange(most, device=begin.device)
        is_listed = entry < end[:, None]
        wall = torch.where(is_listed, self.entries[torch.where(is_listed, entry, 0)], 0)
        return self.walls[wall].unflatten(-1, (2, 2))


_NOWHERE = 1e9
"""Where a wall stands that is out of everyone's reach, m."""
_BEFORE_ALL: dict[str, np.ndarray] = {
    "walls": np.array([[_NOWHERE, _NOWHERE, _NOWHERE + 1, _NOWHERE]]),
    "gates": np.zeros((0, 4)),
    "first_gate": np.zeros(1, np.int64),
    "deck_of_gate": np.zeros(0, np.int64),
    "corners": np.zeros((0, 3)),
    "shapes": np.zeros((0, 3), np.int64),
    "list_of_cell": np.zeros(0, np.int32),
    "lists": np.zeros((1, 3), np.int32),
    "entries": np.zeros(0, np.int32),
}
"""What `CollisionGeometry` begins with: a wall that fills lists up to equal length, and the list of places without."""


def _leads_onto(gates: np.ndarray, stretch: Stretch, length: float) -> np.ndarray:
    """Whether the way to each gate, stations [G], from the one before has a place in common with the stretch: [G]."""
    gap = length / len(gates)
    return on_stretch(gates - gap, stretch, length) | ((stretch[0] - gates + gap) % length <= gap)
