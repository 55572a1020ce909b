"""Worlds of several cars, which see and touch each other.

A world is some consecutive rows of the batch. Or it is one row, and the other cars of its world are `CarState.others`:
opponents, which drive by themselves.

Shapes: `B` rows, `K` cars of each world, `M` = K - 1 others, `R` rays, `S` entries of a vehicle's state. Lengths are in
metres, angles in radians counter-clockwise from +x.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.machine_code import as_array
from carrl.sim.others import CarContact, Others
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.vehicle import VehicleModel
from carrl.tracks.track import Track

MOST_CARS = 64
"""Of a world: each is compared with each."""
_LANES = 8


class Opponents(ABC):
    """Drives the cars that nobody learns to drive, on the CPU."""

    @property
    def files(self) -> Sequence[Path]:
        """What it was read from: a run that is resumed must find these files as they were."""
        return ()

    def memory_size(self, traffic: "Traffic") -> int:
        """Entries of an opponent's memory; 0 where it needs none."""
        return 0

    @abstractmethod
    def prepare(self, traffic: "Traffic") -> Any:
        """What is worth being found out once about a simulator; it becomes its `prepared`."""

    @abstractmethod
    def begin(self, traffic: "Traffic", others: Others, draws: Tensor, track: Tensor) -> Others:
        """The others at the start of an episode, with what they have drawn for it, and their memory if they have one.

        Args:
            traffic: where they drive.
            others: at their places on the road, [B, M], on the middle of it.
            draws: random numbers for each of them, [B, M, 2], float64, in 0..1.
            track: of each world, [B], int64.
        """

    @abstractmethod
    def drive(self, traffic: "Traffic", cars: CarState) -> Others:
        """One step of the others as if each of them were alone.

        Args:
            traffic: where they drive.
            cars: before the step, with the others, [B].

        Returns:
            The others with their states, stations and memories after it; their gates are counted elsewhere.
        """


class Traffic(Simulator):
    """A simulator with several cars in each world.

    All of them drive one step, at the same time, and look then. A car that drives into another one stops there for the
    rest of the step, so that no two of them overlap, and what a step brings says how they touched.

    Args:
        track: where the cars drive; those of one world on the same one.
        vehicle: how they move.
        sensor: what they see.
        device: where the tensors live.
        compiled: as in `Simulator`; what the cars do to each other is machine code in any case.
        slide: as in `Simulator`.
        cars_per_world: K, at least 2.
        bump: share of its speed that a car keeps which touches another one, beside what the push takes or gives; None
            where that ends its episode, so that its speed does not matter.
        opponents: what drives all but one car of each world; None if all of them are rows of the batch.

    Raises:
        ConfigError: there are too many cars to a world, or as in `Simulator`.
    """

    def __init__(
        self,
        track: Track | Sequence[Track],
        vehicle: VehicleModel,
        sensor: Sensor,
        device: torch.device | str = "cpu",
        compiled: bool = True,
        slide: float | None = None,
        *,
        cars_per_world: int,
        bump: float | None = None,
        opponents: Opponents | None = None,
    ) -> None:
        """Compiles where that was not done before."""
        from carrl.sim.traffic_kernel import Outline, meet, see  # Here, since Numba takes half a second to import.

        super().__init__(track, vehicle, sensor, device, compiled, slide)
        if not 2 <= cars_per_world <= MOST_CARS:
            raise ConfigError(f"env.cars_per_world is {cars_per_world}; it must be from 2 to {MOST_CARS}")
        self.cars_per_world, self.opponents, self._bump = cars_per_world, opponents, bump
        outline, angles = vehicle.body.outline, sensor.angles.double().numpy()
        fan = np.zeros(-(-len(angles) // _LANES) * _LANES)
        fan[: len(angles)] = angles
        self._outline = Outline(
            half_length=float(outline.half_size[0]),
            half_width=float(outline.half_size[1]),
            fan=np.stack([np.cos(fan), np.sin(fan)]),
            rays=sensor.rays,
            mount=float(sensor.mount),
            max_range=float(sensor.max_range),
            looks_ahead=bool((np.abs(angles) <= np.pi / 2 + 1e-6).all()),
        )
        nothing = np.zeros((0, len(vehicle.state_names)), np.float32)
        see(self._outline, nothing, cars_per_world, 1, np.zeros((0, sensor.rays), np.float32))
        meet(self._outline, nothing, nothing, cars_per_world)
        self.prepared: Any = opponents.prepare(self) if opponents else None
        self.memory_size = opponents.memory_size(self) if opponents else 0

    @property
    def rows_per_world(self) -> int:
        """Rows of the batch that share a world: 1 where the others are opponents."""
        return 1 if self.opponents else self.cars_per_world

    def sense(self, cars: CarState) -> Tensor:
        """Distances to a wall or another car along each ray, [B, R], float32, m, in [0, max_range]."""
        return self.look(cars)[0]

    def look(self, cars: CarState) -> tuple[Tensor, Tensor]:
        """The distances along the rays, [B, R], float32, m, and whether it is a car that they meet, [B, R], bool.

        The cars are all those of some worlds, or they have `others`.
        """
        return self._look(cars, self._walls_ahead(cars))

    def step(self, cars: CarState, control: Tensor) -> Outcome:
        """Moves every car by one time step, and the others, all at the same time.

        Gates count as far as a car drove. See `Simulator.step` for the rest.

        Args:
            cars: before the step: all those of some worlds, or with the `others`.
            control: named by the vehicle's `control_names`, [B, C], float32.
        """
        alone = super().step(replace(cars, others=None), control)
        others = cars.others if self.opponents else None
        if self.opponents is None or others is None:
            before, after = cars.state, alone.cars.state
        else:
            moved = self.opponents.drive(self, cars).map(lambda values: values.to(cars.state.device))
            before, after = _together(cars.state, others.state), _together(alone.cars.state, moved.state)
        state, share, contact = self._meet(before, after)
        if "speed" in self.vehicle.state_names:
            state = self._pushed(after, state, contact)
        if others is None:
            outcome = replace(alone, contact=contact)
        else:
            state, share = (each.unflatten(0, (-1, self.cars_per_world)) for each in (state, share))
            contact = contact.map(lambda values: values.unflatten(0, (-1, self.cars_per_world))[:, 0])
            others = self._advanced(others, replace(moved, state=state[:, 1:].contiguous()), share[:, 1:], cars.track)
            state, outcome = state[:, 0], replace(alone, cars=replace(alone.cars, others=others), contact=contact)
        outcome = self._held(cars, outcome, state)
        ranges, on_car = self._look(outcome.cars, outcome.ranges)
        return replace(outcome, ranges=ranges, on_car=on_car)

    def look_back(self, cars: CarState) -> Tensor:
        """What the others see, [B * M, R], m: as `sense` tells it of the cars themselves."""
        from carrl.sim.traffic_kernel import see

        others = cars.others
        if others is None:
            raise ConfigError("there are no others in this state; reset the environment")
        track = cars.track[:, None].expand_as(others.next_gate)
        rows = CarState(others.state, others.next_gate, others.gates_passed, track)
        walls = self._walls_ahead(rows.map(lambda values: values.flatten(0, 1)))
        state = torch.cat([others.state, cars.state[:, None]], dim=1).flatten(0, 1)
        seen = see(
            self._outline,
            as_array(state.cpu(), torch.float32),
            self.cars_per_world,
            self.cars_per_world - 1,
            as_array(walls.cpu(), torch.float32),
        )
        return torch.from_numpy(seen[0]).to(walls.device)

    def everyone(self, cars: CarState) -> CarState:
        """All cars of the worlds of cars that have `others`, [B * K]: of each world this one first."""
        others = cars.others
        if others is None:
            raise ConfigError("there are no others in this state; reset the environment")
        station = self.place(cars).station if cars.station is None else cars.station
        return CarState(
            _together(cars.state, others.state),
            _together(cars.next_gate, others.next_gate),
            _together(cars.gates_passed, others.gates_passed),
            cars.track.repeat_interleave(self.cars_per_world),
            _together(station, others.station),
        )

    def neighbours(self, cars: CarState, pace: Tensor | None = None) -> Others:
        """The other cars of each row's world, [B, M], for rows that are all the cars of some worlds.

        Args:
            cars: [B].
            pace: share of their speed at which they drive, [B]: each is told of the others' paces as multiples of its
                own, as if it drove at full speed; None where all drive at full speed.
        """
        rows, count = torch.arange(len(cars.state), device=self.device), self.cars_per_world
        place = torch.arange(1, count, device=self.device)
        index = rows[:, None] // count * count + (rows[:, None] + place) % count
        still = torch.zeros_like(cars.state[index, 0])
        return Others(
            cars.state[index],
            cars.next_gate[index],
            cars.gates_passed[index],
            still if cars.station is None else cars.station[index],
            still,
            None if pace is None else pace[index] / pace[:, None],
        )

    def _look(self, cars: CarState, walls: Tensor) -> tuple[Tensor, Tensor]:
        from carrl.sim.traffic_kernel import see

        state, looking = cars.state, self.cars_per_world
        if cars.others is not None:
            state, looking = _together(state, cars.others.state), 1
        seen = see(
            self._outline,
            as_array(state.cpu(), torch.float32),
            self.cars_per_world,
            looking,
            as_array(walls.cpu(), torch.float32),
        )
        ranges, on_car = map(torch.from_numpy, seen)
        return ranges.to(walls.device), on_car.to(walls.device)

    def _meet(self, before: Tensor, after: Tensor) -> tuple[Tensor, Tensor, CarContact]:
        """The states after the step [B, S], the shares of their ways [B] that cars drove, and how they touched."""
        from carrl.sim.traffic_kernel import meet

        states = (as_array(state.cpu(), torch.float32) for state in (before, after))
        found = meet(self._outline, *states, self.cars_per_world)
        state, share, other, part, at_fault, closing = (torch.from_numpy(each).to(after.device) for each in found)
        return state, share, CarContact(other, part, at_fault, closing / self.vehicle.time_step)

    def _pushed(self, alone: Tensor, state: Tensor, contact: CarContact) -> Tensor:
        """The states after the step, [B, S], of which those that touched have pushed each other.

        Both have the same mass and none bounces off: along the line between them their speeds become the same.

        Args:
            alone: as if each were alone, [B, S].
            state: the same at the poses where the touches left them, [B, S].
            contact: of each.
        """
        row = contact.touched.nonzero()[:, 0]
        if not len(row):
            return state
        mate = row // self.cars_per_world * self.cars_per_world + contact.other[row]
        names = self.vehicle.state_names

        def velocity(rows: Tensor) -> Tensor:
            speed, course = alone[rows, names.index("speed")], alone[rows, 2]
            if "slip" in names:
                course = course + alone[rows, names.index("slip")]
            return torch.stack([speed * course.cos(), speed * course.sin()], dim=-1)

        own, way = velocity(row), state[mate, :2] - state[row, :2]
        line = way / torch.linalg.vector_norm(way, dim=-1, keepdim=True).clamp(min=1e-6)
        closing = ((own - velocity(mate)) * line).sum(-1, keepdim=True).clamp(min=0)
        left, heading = own - line * closing / 2, state[row, 2]
        ahead = left[:, 0] * heading.cos() + left[:, 1] * heading.sin()
        kept = 1.0 if self._bump is None else self._bump
        return state.index_copy(0, row, self.vehicle.going_on(alone[row], state[row, :3], kept * ahead.clamp(min=0)))

    def _held(self, before: CarState, outcome: Outcome, state: Tensor) -> Outcome:
        """The outcome in these states, [B, S], of which some are of cars that another one has stopped on the way."""
        assert outcome.contact is not None
        row = outcome.contact.touched.nonzero()[:, 0]
        cars = replace(outcome.cars, state=state)
        if not len(row):
            return replace(outcome, cars=cars)
        held = replace(cars, others=None)[row]
        ranges = outcome.ranges.index_copy(0, row, self._walls_ahead(held))
        outcome = replace(outcome, cars=cars, ranges=ranges)
        return self._recounted(before, outcome, row) if bool(outcome.gates_passed[row].any()) else outcome

    def _recounted(self, before: CarState, outcome: Outcome, row: Tensor) -> Outcome:
        """The outcome with the gates that the cars of these rows [n] have passed where they drove less of their way."""
        earlier, cars = replace(before, others=None)[row], outcome.cars
        passed = self._count_gates(earlier.pose[:, :2].double(), cars.pose[row, :2].double(), earlier)
        passed = torch.minimum(passed, outcome.gates_passed[row])
        next_gate = (earlier.next_gate + passed) % self.gate_counts[earlier.track]
        counted = replace(
            cars,
            next_gate=cars.next_gate.index_copy(0, row, next_gate),
            gates_passed=cars.gates_passed.index_copy(0, row, earlier.gates_passed + passed),
        )
        return replace(outcome, cars=counted, gates_passed=outcome.gates_passed.index_copy(0, row, passed))

    def _advanced(self, others: Others, moved: Others, share: Tensor, track: Tensor) -> Others:
        """The others after a step in which they moved so, but drove a share of it, [B, M], on the tracks [B]."""
        count = self.gate_counts[track, None]
        length = self.routes.lengths.to(share.device)[track, None]
        before = others.station.double()
        way = (moved.station.double() - before + length / 2) % length - length / 2
        reached = ((before + share * way) % length).float()
        gates = [(each.double() * count / length).floor().long() for each in (others.station, reached)]
        passed = (gates[1] - gates[0] + count // 2) % count - count // 2
        return replace(
            moved,
            station=reached,
            next_gate=gates[1] % count,
            gates_passed=others.gates_passed + passed,
        )


def _together(own: Tensor, others: Tensor) -> Tensor:
    """What one car and the others of each world have, [B, ...] and [B, M, ...], as rows, [B * K, ...]."""
    return torch.cat([own[:, None], others], dim=1).flatten(0, 1)
