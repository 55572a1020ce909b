"""What there is to draw of a car: how it is at one moment, and how it looks.

Shapes: `R` rays, `T` time steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from carrl.render.raster.projection import Floats


@dataclass(frozen=True)
class Scene:
    """A car at one moment of its episode.

    Attributes:
        pose: x m, y m, heading rad counter-clockwise from +x, [3].
        readings: distance along each ray / range, [R], in 0..1.
        next_gate: index of the gate that counts next.
        gates_passed: since the start.
        step: steps since the start.
        steer: how far the wheel is turned, -1 right to 1 left.
        action: what the last action is called.
        episode_return: sum of the rewards since the start.
        collided: the car touched a wall in the last step.
        trail: where the car was before, oldest first, [T, 2], m.
        track: index of what it drives on.
    """

    pose: Floats
    readings: Floats
    next_gate: int
    gates_passed: int
    step: int
    steer: float
    action: str
    episode_return: float
    collided: bool = False
    trail: Sequence[Floats] = ()
    track: int = 0


@dataclass(frozen=True)
class CarLook:
    """What the pictures need to know of a car.

    Attributes:
        body_radius: m.
        speed: m/s.
        time_step: s.
        sensor_angles: directions of the rays, [R], rad counter-clockwise from the heading.
        sensor_range: m.
    """

    body_radius: float
    speed: float
    time_step: float
    sensor_angles: Floats
    sensor_range: float
