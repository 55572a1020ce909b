"""The other cars of a car's world, and how it touches them.

Shapes: `B` cars, `M` others of each, `S` entries of a vehicle's state, `Q` of an opponent's memory.
"""

from dataclasses import dataclass

from torch import Tensor

from carrl.rows import Rows

PARTS = ("none", "front", "rear", "left", "right")
"""Of a car, as `CarContact.part` counts them; a corner is part of the front or the rear."""


@dataclass
class Others(Rows):
    """The other cars of each car's world.

    Attributes:
        state: of the vehicle model, [B, M, S], float32.
        next_gate: as in `CarState`, [B, M], int64.
        gates_passed: [B, M], int64.
        station: [B, M], float32, m.
        lane: that an opponent has drawn for the episode, from -1 at the right edge of the road to 1 at the left one,
            [B, M], float32; 0 of those that keep to none.
        pace: that it has drawn, a share, [B, M], float32; None of cars that are no opponents.
        memory: what an opponent has to know of the steps before, [B, M, Q], float32; None where it needs none.
    """

    state: Tensor
    next_gate: Tensor
    gates_passed: Tensor
    station: Tensor
    lane: Tensor
    pace: Tensor | None = None
    memory: Tensor | None = None


@dataclass
class CarContact(Rows):
    """Who touched whom in a step, and how; of each car its first touch.

    Attributes:
        other: place of the other car among those of its world, [B], int64; -1 for a car that touched none.
        part: of the car that touched, [B], int64, an index into `PARTS`.
        at_fault: whether the car drove with its front into the other one, [B], bool.
        closing_speed: at which the two came together, [B], float32, m/s.
    """

    other: Tensor
    part: Tensor
    at_fault: Tensor
    closing_speed: Tensor

    @property
    def touched(self) -> Tensor:
        """Whether there was any, [B], bool."""
        return self.other >= 0
