"""Who races, and where all stand at the start of races that are driven side by side.

Shapes: `W` races, `K` cars of each, `B` = W * K cars, race by race.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.evaluation.rollout import Policy
from carrl.sim.simulator import CarState
from carrl.sim.traffic import MOST_CARS, Traffic
from carrl.task.checks import whole_number
from carrl.task.task import World
from carrl.tracks.track import Track


class Entrant(NamedTuple):
    """Who drives a car.

    Attributes:
        name: that no other entrant has.
        world: as the policy sees it.
        policy: what to do.
    """

    name: str
    world: World
    policy: Policy


@dataclass(frozen=True)
class Grid:
    """Races at their start.

    Attributes:
        traffic: where they are driven.
        cars: its rows: [B], or where each is among opponents [W].
        line: station of the start line, where the first car stands, [W], m.
        behind: how far each car starts behind the line, [B], m.
    """

    traffic: Traffic
    cars: CarState
    line: Tensor
    behind: Tensor

    @property
    def own(self) -> slice:
        """Which of all cars are the rows."""
        return slice(None, None, self.traffic.cars_per_world if self.traffic.opponents else 1)

    def everyone(self, cars: CarState) -> CarState:
        """All cars, [B]."""
        return self.traffic.everyone(cars) if cars.others else cars

    def pace(self, cars: CarState) -> Tensor | None:
        """Share of their speed at which all cars drive, [B]."""
        if cars.others is None or cars.others.pace is None:
            return None
        return torch.cat([torch.ones_like(cars.others.pace[:, :1]), cars.others.pace], dim=1).flatten()


def in_a_row(entrants: Sequence[Entrant], track: Track, races: int) -> Grid:
    """Entrants one behind the other, in an order that moves on from race to race."""
    first, count = entrants[0].world, whole_number("the number of cars", len(entrants), 2, MOST_CARS)
    for entrant in entrants:
        if entrant.world.vehicle != first.vehicle:
            raise ConfigError(
                f"cars that race must be the same; that of {entrants[0].name} is {first.vehicle}, and that of "
                f"{entrant.name} is {entrant.world.vehicle}"
            )
    bump = next((each.world.bump for each in entrants if each.world.bump is not None), None)
    traffic = Traffic([track], first.vehicle, first.sensor, cars_per_world=count, bump=bump)
    need = _room(traffic, max(entrant.world.gap for entrant in entrants))
    line = torch.arange(races).double() * track.length / races
    place = (torch.arange(count) + torch.arange(races)[:, None]) % count
    stations = (line[:, None] - place.double() * need).flatten() % track.length
    cars = replace(traffic.start(stations), station=stations.float())
    return Grid(traffic, cars, line, place.flatten().double() * need)


def among_opponents(entrant: Entrant, track: Track, races: int) -> Grid:
    """An entrant behind the opponents of its world."""
    world = entrant.world
    if world.opponents is None:
        raise ConfigError(f"{entrant.name} has nobody to race; name several runs, or opponents")
    traffic = world.simulator([track])
    assert isinstance(traffic, Traffic)
    _room(traffic, world.gap)
    stations = torch.arange(races).double() * track.length / races
    cars = replace(world.at_start(traffic, stations, None), station=stations.float())
    ahead = (traffic.everyone(cars).station.view(races, -1).double() - stations[:, None]) % track.length  # type: ignore[union-attr]
    ahead[:, 0] = 0.0
    front = ahead.max(dim=1, keepdim=True).values
    return Grid(traffic, cars, (stations + front[:, 0]) % track.length, (front - ahead).flatten())


def _room(traffic: Traffic, gap: float) -> float:
    """From one car to the next at the start, m."""
    need, length = (gap + 1) * traffic.vehicle.body.outline.length, float(traffic.routes.lengths.min())
    if need * traffic.cars_per_world > length:
        raise ConfigError(
            f"{traffic.cars_per_world} cars take {need * traffic.cars_per_world:.0f} m of road to start; track "
            f"'{traffic.track.name}' has {length:.0f} m"
        )
    return need
