"""What the driver is told: its sensors, and if it is to drive smoothly, what it did last.

Shapes: `B` cars, `R` rays; `N` cars of all random streams, of which the `B` cars are some.
"""

import torch
from torch import Tensor

from carrl.env.random_streams import RandomStreams
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import Action

FIRST_ACTION = Action.FORWARD
"""What counts as the action before the first one of an episode."""


def observation_size(rays: int, observe_action: bool) -> int:
    """How many values an observation has."""
    return rays + len(Action) * observe_action


def read(sensor: Sensor, ranges: Tensor, streams: RandomStreams, wanted: Tensor | None = None) -> Tensor:
    """What the sensor reads, its noise and dropout drawn from the cars' own streams.

    Args:
        sensor: may be exact; then nothing is drawn.
        ranges: true distances, [B, R], m.
        streams: of the random numbers.
        wanted: which cars of the streams the `B` cars are, [N], bool; all by default.

    Returns:
        [B, R], in 0..1.
    """
    if sensor.is_exact:
        return ranges / sensor.max_range
    draws = streams.normal(sensor.rays, wanted=wanted), streams.uniform(sensor.rays, wanted=wanted)
    errors, chances = (draw if wanted is None else draw[wanted] for draw in draws)
    return sensor.err(ranges, errors.to(ranges), chances.to(ranges)) / sensor.max_range


def observe(readings: Tensor, last_action: Tensor, observe_action: bool) -> Tensor:
    """The observation, [B, R], or with `observe_action` [B, R + 3], all in 0..1.

    Args:
        readings: distance along each ray / range, [B, R], float32, right to left.
        last_action: values of `Action`, [B], int64.
        observe_action: append the last action, one-hot.
    """
    if not observe_action:
        return readings
    one_hot = last_action[:, None] == torch.arange(len(Action), device=last_action.device)
    return torch.cat([readings, one_hot.to(readings.dtype)], dim=-1)
