"""What becomes of the cars of races, step by step: places, contacts, who is out and who has finished, and when.

Shapes: `W` races, `K` cars of each, `B` = W * K cars, race by race; `T` steps.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from carrl.evaluation.lap_timing import LapTiming
from carrl.evaluation.passing import ContactCounter
from carrl.evaluation.race_grid import Grid
from carrl.evaluation.rollout import patience_of, time_limits
from carrl.evaluation.standings import Result
from carrl.racing import SECTORS
from carrl.sim.simulator import CarState, Outcome

ENDINGS = ("time", "finished", "wall", "car")
"""How a race ends for a car; `Result.ended`."""
_TIME, _FINISHED, _WALL, _CAR = range(len(ENDINGS))


class Tally:
    """What has become of the cars so far.

    Args:
        grid: of the races.
        cars: all of them at the start, [B].
        laps: of each race.
        ends_at_cars: which cars are out where they touch another one, [B], bool.

    Attributes:
        limit: steps after which a race is over.
        on_road: which cars are still driving, [B], bool.
        collided: which of them touched a wall in the last step, [B], bool.
        is_out: which of them touched something in the last step that takes them off the road, [B], bool.
    """

    def __init__(self, grid: Grid, cars: CarState, laps: int, ends_at_cars: Tensor) -> None:
        self._grid, self._laps, self._ends_at_cars = grid, laps, ends_at_cars
        traffic, count = grid.traffic, grid.traffic.cars_per_world
        stations = cars.station.double()  # type: ignore[union-attr]
        self._timing = LapTiming(traffic, cars, stations, laps, grid.behind)
        self._length = float(traffic.routes.lengths[0])
        self.limit = (laps + 1) * int(time_limits(traffic, cars).max())
        self._patience = patience_of(traffic, cars)
        self._contacts = ContactCounter(grid.cars)
        self._way, none = -grid.behind, torch.zeros_like(cars.next_gate)
        self.on_road, self.collided, self.is_out = ~none.bool(), none.bool(), none.bool()
        self._place = (self._way.view(-1, count)[:, None] > self._way.view(-1, count)[..., None]).sum(-1).flatten() + 1
        self._ended, self._steps, self._last_gate, self._overtakes = none, none.clone(), none.clone(), none.clone()
        self._driven = torch.zeros_like(self._way)
        self._own, self._others = torch.zeros_like(grid.cars.next_gate), torch.zeros_like(grid.cars.next_gate)

    def step(self, number: int, before: CarState, after: CarState, outcome: Outcome) -> None:
        """Counts what a step brought to all cars, [B]; the outcome is that of the rows alone."""
        traffic, own, drove, contact = self._grid.traffic, self._grid.own, self.on_road, outcome.contact
        assert contact is not None
        moved = after.station.double() - before.station.double()  # type: ignore[union-attr]
        way = self._way + torch.where(drove, (moved + self._length / 2) % self._length - self._length / 2, 0.0)
        self._overtakes = self._overtakes + self._passed(self._way, way)
        self._way = way
        distance = torch.linalg.vector_norm(after.pose[:, :2].double() - before.pose[:, :2].double(), dim=-1)
        self._driven = self._driven + torch.where(drove, distance, 0.0)
        by_own_fault, otherwise = self._contacts.step(contact)
        self._own = self._own + by_own_fault * drove[own]
        self._others = self._others + otherwise * drove[own]
        self.collided, touched = torch.zeros_like(drove), torch.zeros_like(drove)
        self.collided[own], touched[own] = outcome.collided & drove[own], contact.touched & self._ends_at_cars[own]
        self._last_gate = torch.where(after.gates_passed > before.gates_passed, number, self._last_gate)
        stands = torch.zeros_like(drove)
        stands[own] = (number - self._last_gate >= self._patience)[own]
        finished = self._timing.has_ended(before, after, traffic.has_lapped(after, self._laps))
        ended = torch.where(finished, _FINISHED, _TIME)
        ended = torch.where(self.collided, _WALL, torch.where(touched, _CAR, ended))
        self.is_out = drove & (self.collided | touched)
        over = drove & (self.is_out | finished | stands | torch.tensor(number == self.limit))
        self._ended = torch.where(over, ended, self._ended)
        self.on_road = drove & ~over
        self._steps = torch.where(drove, number, self._steps)

    def _passed(self, before: Tensor, after: Tensor) -> Tensor:
        """How many others each car has passed by these ways, [B], in a step."""
        count = self._grid.traffic.cars_per_world
        leads = (each.view(-1, count)[..., None] - each.view(-1, count)[:, None] for each in (before, after))
        was, now = leads
        drives = self.on_road.view(-1, count)
        return ((was <= 0) & (now > 0) & drives[..., None] & drives[:, None]).sum(-1).flatten()

    def results(self, course: CarState, names: Sequence[str]) -> list[Result]:
        """Of all cars, by their course [T + 1, B]."""
        was_out = (self._ended == _WALL) | (self._ended == _CAR)
        sectors = self._timing.sector_times(course, self._steps - was_out.long())
        counts = {"contacts_own": self._own.tolist(), "contacts_others": self._others.tolist()}
        rows = torch.full_like(self._steps, -1)
        rows[self._grid.own] = torch.arange(len(self._own))
        results = []
        for car, (row, own) in enumerate(zip(rows.tolist(), sectors, strict=True)):
            laps = [sum(each) for each in own if len(each) == SECTORS]
            finished = self._ended[car] == _FINISHED and len(laps) == self._laps
            results.append(
                Result(
                    car=names[car % len(names)],
                    start=int(self._place[car]),
                    ended=ENDINGS[int(self._ended[car])],
                    time=sum(laps) if finished else None,
                    way=float(self._way[car]),
                    best_lap=min(laps, default=None),
                    overtakes=int(self._overtakes[car]),
                    driven_km=float(self._driven[car]) / 1000,
                    **{name: values[row] if row >= 0 else None for name, values in counts.items()},
                )
            )
        return results
