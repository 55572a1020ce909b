"""Moments and steps of a car on a road 100 m square, whose place on it is easily worked out."""

from dataclasses import replace
from functools import cache

import torch
from torch import Tensor

from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.task.action import ContinuousActions
from carrl.task.episode import EpisodeState, ObservationContext, StepContext
from carrl.task.random_streams import RandomStreams
from tests.sim.test_places import square_road

ACTIONS = ContinuousActions(("steer", "pedal"))
NAMES = Kinematic.state_names


@cache
def simulator() -> Simulator:
    """Cars with a speed of their own, three rays of 10 m, on the square: 4 m to the left wall, 6 m to the right one."""
    return Simulator(square_road(), Kinematic(), Sensor(rays=3, max_range=10.0))


def cars_with(last_station: float, **values: float) -> CarState:
    """One car whose state has these values, the others being zero."""
    state = torch.tensor([[values.get(name, 0.0) for name in NAMES]])
    return replace(CarState.at(state), station=torch.tensor([last_station]))


def moment(
    last_station: float = 0.0, last_action: tuple[float, float] = (0.0, 0.0), **values: float
) -> ObservationContext:
    """What the driver of such a car is told of."""
    cars = cars_with(last_station, **values)
    place = simulator().place(cars)
    state = EpisodeState(replace(cars, station=place.station), torch.tensor([3]), torch.tensor([last_action]))
    ranges = simulator().sense(cars)
    return ObservationContext(state, ranges, simulator(), ACTIONS, RandomStreams([0], 1), place=place)


def step_of(
    before: CarState,
    after: CarState,
    collided: bool = False,
    action: tuple[float, float] = (0.0, 0.0),
    last_action: tuple[float, float] = (0.0, 0.0),
    stalled: int = 0,
) -> StepContext:
    """A step from one car to the next."""
    place = simulator().place(replace(after, station=before.station))
    outcome = Outcome(after, simulator().sense(after), torch.tensor([collided]), torch.tensor([0]), place)
    state = EpisodeState(before, torch.tensor([3]), torch.tensor([last_action]), stalled=torch.tensor([stalled]))
    return StepContext(state, torch.tensor([action]), outcome, simulator(), ACTIONS)


def value(tensor: Tensor) -> float:
    """Of one car and one entry."""
    return tensor.item()
