"""Which walls are near a place: a grid of square cells, each with the list of the walls that come within reach of it.

The lists are exact: a wall that comes within reach of any point of a cell is in the cell's list, so whoever looks no
further than that misses nothing. Cells are a quarter of the reach wide, so that memory grows with the number of walls
and not with the reach; they are wider on a track so large that there would be more than `MOST_CELLS`.

Shapes: `S` walls, `C` cells, `L` lists, `E` entries of all lists together, `P` pairs of a wall and a cell.
"""

import math
from dataclasses import dataclass

import numpy as np

from carrl.errors import TrackError

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
