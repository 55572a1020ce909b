"""Races: cars that start in a row and drive some laps, each with the sensors and the network of its run.

All cars of a race share a world, and several races are driven side by side. A car that has finished is taken off the
road, and so is one that touches a wall or, where that ended the episodes of its run, another car: its pose is no number
any more, so that nobody sees or touches it.

Shapes: `W` races, `K` cars of each, `B` = W * K cars, race by race.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from carrl.evaluation.asked import MOST_LAPS, MOST_RACES
from carrl.evaluation.driver import Decision, Driver
from carrl.evaluation.race_grid import Entrant, Grid, among_opponents, in_a_row
from carrl.evaluation.race_recording import RaceRecording
from carrl.evaluation.race_tally import Tally
from carrl.evaluation.rollout import Recorder
from carrl.evaluation.standings import Race
from carrl.sim.simulator import CarState
from carrl.task.checks import whole_number
from carrl.tracks.track import Track


def drive_races(
    entrants: Sequence[Entrant], track: Track, laps: int, races: int, recorder: Recorder | None = None
) -> list[Race]:
    """Races of these entrants; of one alone against the opponents of its world, from behind all of them.

    The start lines are spread evenly along the track. Several entrants start in an order that moves on by a place from
    race to race. The recorder keeps what the first entrant's car drives, an episode for each race.

    Raises:
        ConfigError: their cars differ, there is nobody to race, or no room for all.
    """
    laps, races = whole_number("laps", laps, 1, MOST_LAPS), whole_number("races", races, 1, MOST_RACES)
    grid = among_opponents(entrants[0], track, races) if len(entrants) == 1 else in_a_row(entrants, track, races)
    drivers = _Drivers(entrants, track, grid)
    recording = RaceRecording(recorder, *entrants[0][1:], grid) if recorder else None
    cars = grid.cars
    everyone, pace = grid.everyone(cars), grid.pace(cars)
    tally, moments = Tally(grid, everyone, laps, drivers.ends_at_cars), [everyone]
    decisions = drivers.decide(everyone, None, pace)
    for step in range(1, tally.limit + 1):
        outcome, drove = grid.traffic.step(cars, drivers.controls(decisions)[grid.own]), tally.on_road
        place = grid.traffic.place(replace(outcome.cars, station=cars.station))
        outcome = replace(outcome, cars=replace(outcome.cars, station=place.station), place=place)
        after = grid.everyone(outcome.cars)
        tally.step(step, everyone, after, outcome)
        moments.append(after)
        if drove[grid.own].any():  # else only opponents are left
            before, decisions = decisions, drivers.decide(after, tally.collided, pace)
            if recording is not None:
                pair = before[0], decisions[0]
                recording.add(step, cars, outcome, pair, drove, tally.on_road, tally.is_out)
        if not tally.on_road.any():
            break
        state = torch.where(tally.on_road[grid.own, None], outcome.cars.state, torch.nan)
        cars = replace(outcome.cars, state=state)
        everyone = grid.everyone(cars)
    results = tally.results(CarState.stack(moments), _names(entrants, grid))
    count = grid.traffic.cars_per_world
    return [
        Race.of(track.name, float(line), results[begin : begin + count])
        for begin, line in zip(range(0, len(results), count), grid.line, strict=True)
    ]


def _names(entrants: Sequence[Entrant], grid: Grid) -> list[str]:
    """Of the cars of a race."""
    kind = type(grid.traffic.opponents).__name__.removesuffix("Opponents").lower()
    others = grid.traffic.cars_per_world - len(entrants)
    return [*(entrant.name for entrant in entrants), *(f"{kind} {number + 1}" for number in range(others))]


class _Drivers:
    """What drives the entrants' cars, each run's network once, however many cars it drives."""

    def __init__(self, entrants: Sequence[Entrant], track: Track, grid: Grid) -> None:
        count, cars = grid.traffic.cars_per_world, len(grid.behind)
        self._drivers: list[Driver] = []
        self._rows: list[Tensor] = []
        self.ends_at_cars = torch.zeros(cars, dtype=torch.bool)
        drivers: dict[int, int] = {}
        for place, entrant in enumerate(entrants):
            rows = torch.arange(place, cars, count)
            self.ends_at_cars[rows] = entrant.world.bump is None
            index = drivers.setdefault(id(entrant.policy), len(self._drivers))
            if index == len(self._drivers):
                self._drivers.append(Driver(entrant.world, entrant.policy, [track], count, cars))
                self._rows.append(rows)
            else:
                self._rows[index] = torch.cat([self._rows[index], rows])
        self._memories = [driver.blank_memory(cars) for driver in self._drivers]

    def decide(self, cars: CarState, collided: Tensor | None, pace: Tensor | None) -> list[Decision]:
        """What each of them would do with every car, [B], the first entrant's first."""
        decisions = [
            driver.decide(cars, memory, collided, pace)
            for driver, memory in zip(self._drivers, self._memories, strict=True)
        ]
        self._memories = [decision.memory for decision in decisions]
        return decisions

    def controls(self, decisions: Sequence[Decision]) -> Tensor:
        """What is done with the cars, [B, C], each by its own driver; with those of opponents nothing."""
        controls = torch.zeros_like(decisions[0].controls)
        for decision, rows in zip(decisions, self._rows, strict=True):
            controls[rows] = decision.controls[rows]
        return controls
