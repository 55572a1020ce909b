"""Steps made up by hand, as the terms of a reward see them."""

from dataclasses import replace
from functools import cache

import torch
from torch import Tensor

from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.task.action import ActionMap, steer3
from carrl.task.episode import EpisodeState, StepContext
from carrl.tracks.track import Track

RANGE = 1.0
"""Of the sensor, m, so that distances are readings."""


@cache
def oval() -> Simulator:
    """Three rays on the oval."""
    return Simulator(Track.load("oval"), Vehicle(), Sensor(rays=3, max_range=RANGE))


def cars_before_gates(distances: list[float], gates: list[int] | None = None) -> CarState:
    """Cars so far, m, from the middles of these gates of the oval, by default of the first, which count next."""
    next_gate = torch.tensor(gates or [0] * len(distances))
    middles = oval().track.gates.mean(dim=1)[next_gate]
    place = middles + torch.tensor(distances)[:, None] * torch.tensor([0.6, -0.8])
    cars = CarState.at(torch.cat([place, torch.zeros(len(place), 1)], dim=-1).float())
    return replace(cars, next_gate=next_gate)


def make_step(
    nearest: float = 0.5,
    collided: bool | list[bool] = False,
    gates: int = 0,
    action: int | float = 0,
    last_action: int | float = 0,
    *,
    before: CarState | None = None,
    after: CarState | None = None,
    actions: ActionMap | None = None,
) -> StepContext:
    """One step of one car, or of as many as there are before it; `nearest` is the least of its three readings."""
    before = before or cars_before_gates([10.0])
    count = len(before.next_gate)

    def each(value: object) -> Tensor:
        return torch.as_tensor(value).expand(count)

    ranges = torch.tensor([[1.0, nearest, 0.7]]).expand(count, 3) * RANGE
    outcome = Outcome(after or before, ranges, each(collided), each(gates))
    state = EpisodeState(before, each(0), _actions(last_action, count))
    return StepContext(state, _actions(action, count), outcome, oval(), actions or steer3())


def _actions(value: int | float, count: int) -> Tensor:
    """Indices [N], or values of one control [N, 1]."""
    return torch.full((count,), value) if isinstance(value, int) else torch.full((count, 1), value)
