"""Opponents that drive as an earlier run has learnt to.

Shapes: `B` worlds, `M` opponents of each, `K` = M + 1 cars, `N` = B * M, `Q` entries of an opponent's memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.evaluation.driver import Driver
from carrl.opponents.pace import check_pace, drawn_pace, opponents_of, paces_of
from carrl.opponents.put_back import put_back
from carrl.sim.others import Others
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.traffic import Opponents, Traffic
from carrl.sim.vehicle import ConstantSpeed, VehicleModel
from carrl.train.build import load_driver
from carrl.train.files import checkpoint_path, opponents_config


@dataclass(frozen=True)
class PolicyOpponents(Opponents):
    """The best network of an earlier run, without exploration, in its own car and with its own sensors, made exact.

    One that touches a wall is put back on the middle of the road beside that place, and at rest.

    Attributes:
        run: the folder of a run of one seed, whose car has the same state and body as the one that learns.
        pace: share of its speed at which it drives, of cars that only steer; it sees the world as much slower.
        spread: by how much an opponent's pace may be more or less, drawn for each episode.
    """

    run: str
    pace: float = 1.0
    spread: float = 0.0

    def __post_init__(self) -> None:
        """Raises CarrlError for a share out of its range, and for a folder that is no run's."""
        check_pace(self.pace, self.spread)
        opponents_config(self.run)

    @property
    def files(self) -> Sequence[Path]:
        """The network."""
        return (checkpoint_path(Path(self.run), "best"),)

    def memory_size(self, traffic: Traffic) -> int:
        """That of the driver."""
        driver: Driver = traffic.prepared
        return driver.memory_size

    def prepare(self, traffic: Traffic) -> Driver:
        """The driver.

        Raises:
            CarrlError: the run is damaged, or its car is of another kind, or cannot be slowed down.
        """
        world, policy = load_driver(Path(self.run), opponents_config(self.run))
        if _kind(world.vehicle) != _kind(traffic.vehicle):
            raise ConfigError(
                f"the car of opponents.run '{self.run}', {_described(world.vehicle)}, is of another kind than the one "
                f"that learns, {_described(traffic.vehicle)}; opponents need its body, time step and state"
            )
        if self._is_slowed and not isinstance(world.vehicle, ConstantSpeed):
            raise ConfigError(
                f"opponents.pace is {self.pace} and opponents.spread {self.spread}, but the driver of a "
                f"{type(world.vehicle).__name__} chooses its speed itself; leave both out"
            )
        world = replace(world, sensor=replace(world.sensor, noise=0.0, dropout=0.0))
        count = traffic.cars_per_world
        return Driver(world, policy, traffic.tracks, count, count)

    def begin(self, traffic: Traffic, others: Others, draws: Tensor, track: Tensor) -> Others:
        """With a pace of their own, as a share of the learner's speed, and nothing to remember."""
        driver: Driver = traffic.prepared
        pace = drawn_pace(self.pace, self.spread, draws[..., 0]) * _own_speed(driver.traffic, traffic)
        memory = driver.blank_memory(pace.numel()).view(*pace.shape, -1)
        return replace(others, pace=pace.to(others.state.device), memory=memory.to(others.state.device))

    def drive(self, traffic: Traffic, cars: CarState) -> Others:
        """As the network decides, if nothing is in the way but walls."""
        driver: Driver = traffic.prepared
        cars = cars.map(lambda values: values.cpu())
        others, own = opponents_of(cars), driver.traffic
        assert others.memory is not None
        pace, shape = paces_of(others) / _own_speed(own, traffic), others.next_gate.shape
        blank = driver.blank_memory(len(pace))[:, None]
        everyone, memory = own.everyone(cars), torch.cat([blank, others.memory], dim=1).flatten(0, 1)
        paces = torch.cat([1 / _own_speed(own, traffic) * torch.ones_like(pace[:, :1]), pace], dim=1).flatten()
        decision = driver.decide(everyone, memory, pace=paces if isinstance(own.vehicle, ConstantSpeed) else None)
        rows = torch.arange(len(paces)).view(-1, traffic.cars_per_world)[:, 1:].flatten()
        before = everyone[rows]
        outcome = self._alone(own, before, decision.controls[rows], paces[rows])
        after = put_back(own, before, outcome.cars.state, outcome.collided)
        kept = torch.where(outcome.collided[:, None], blank[:1, 0], decision.memory[rows])
        return replace(
            others,
            state=after.view(*shape, -1),
            station=own.place(replace(before, state=after)).station.view(shape),
            memory=kept.view(*shape, -1),
        )

    def _alone(self, own: Traffic, cars: CarState, controls: Tensor, pace: Tensor) -> Outcome:
        """What becomes of opponents, [N], in a step without other cars."""
        if self._is_slowed and isinstance(own.vehicle, ConstantSpeed):
            return own.follow(cars, own.vehicle.step_at(cars.state, controls, pace))
        return Simulator.step(own, cars, controls)

    @property
    def _is_slowed(self) -> bool:
        return self.pace < 1 or self.spread > 0


def _kind(vehicle: VehicleModel) -> tuple[object, ...]:
    """What cars that share a world must have in common."""
    return vehicle.state_names, vehicle.body, vehicle.time_step


def _described(vehicle: VehicleModel) -> str:
    names = ", ".join(vehicle.state_names)
    return (
        f"a {type(vehicle).__name__} with the body {vehicle.body}, steps of {vehicle.time_step} s and the state {names}"
    )


def _own_speed(own: Traffic, traffic: Traffic) -> float:
    """The opponents' speed as a share of the learner's, of cars that have but one; else 1."""
    if isinstance(own.vehicle, ConstantSpeed) and isinstance(traffic.vehicle, ConstantSpeed):
        return own.vehicle.speed / traffic.vehicle.speed
    return 1.0
