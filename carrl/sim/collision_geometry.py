"""All that cars can meet on any number of tracks: walls, gates, and which of them count where, as flat tensors.

A car sees the walls of one *deck* of its track. A track without a bridge has one deck. On others, cars on the road
that goes over see all but the walls of the road below it, and all other cars see all but the walls of the road above.
Which deck a car is on follows from the gate that it heads for.

Shapes: `T` tracks, `K` decks of all tracks, `S` walls, `G` gates, `C` cells, `L` lists, `E` entries, `B` cars. Lengths
are in metres.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from carrl.errors import TrackError
from carrl.sim.wall_grid import WallGrid
from carrl.tracks.bridges import Stretch, on_stretch
from carrl.tracks.track import Track


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
