"""A point in time of a training run."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Moment:
    """Where the training of an agent stands.

    Attributes:
        frames: env steps done.
        updates: of the network.
        epsilon: probability of a random action in the next step.
        loss: before the last update; nan if there was none.
        wall_time_s: since training began, s.
    """

    frames: int
    updates: int
    epsilon: float
    loss: float
    wall_time_s: float
