"""What the driver is told of the other cars, and what passing and touching them earns.

Where a car is alone it is told of none, and earns nothing: so what learnt among others can be tried out alone.

Shapes: `N` cars, `M` others of each, `R` rays.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from carrl.config import is_whole_number
from carrl.errors import ConfigError
from carrl.sim.others import Others
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.traffic import MOST_CARS
from carrl.sim.vehicle import ConstantSpeed
from carrl.task.action import ActionMap
from carrl.task.episode import ObservationContext, StepContext
from carrl.task.motion import WIDE, check_unit
from carrl.task.observation import Part
from carrl.task.reward import FiniteTerm

VALUES_OF_A_CAR = 5


@dataclass(frozen=True)
class RaysOnCars:
    """1 for each ray that ends at a car, 0 for those that end at a wall or at nothing; right to left."""

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value a ray."""
        return Part(name, sensor.rays, 0.0, 1.0)

    def __call__(self, context: ObservationContext) -> Tensor:
        """As it is, whatever the sensor reads."""
        on_car = context.on_car
        return torch.zeros_like(context.ranges) if on_car is None else on_car.to(context.ranges)


@dataclass(frozen=True)
class NearestCars:
    """Where the nearest other cars are, and how they move against this one.

    Of each car 1, and as this one sees it: how far ahead it is and how far to the left, and how fast it moves ahead
    and to the left, less this one's own motion. All are 0 where there is no such car.

    Attributes:
        count: of the cars, from the nearest to the furthest.
        reach: how far off they may be, m; it counts as 1.
        speed: that counts as 1, m/s.
    """

    needs: ClassVar[tuple[str, ...]] = ("others",)
    count: int = 2
    reach: float = 50.0
    speed: float = 20.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a value out of its range."""
        if not (is_whole_number(self.count) and 1 <= self.count < MOST_CARS):
            raise ConfigError(
                f"observation: count of NearestCars is {self.count}; it must be a whole number from 1 to "
                f"{MOST_CARS - 1}"
            )
        check_unit(self.reach, "NearestCars (its reach)")
        check_unit(self.speed, "NearestCars (its speed)")

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """Five values a car."""
        return Part(name, VALUES_OF_A_CAR * self.count, -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        """The nearest first, [N, 5 * count]."""
        cars, others = context.state.cars, context.state.cars.others
        told = context.ranges.new_zeros(len(cars.state), self.count, VALUES_OF_A_CAR)
        if others is None:
            return told.flatten(1)
        way = others.state[..., :2] - cars.state[:, None, :2]
        moves = _velocities(others.state, context.simulator, others.pace)
        moves = moves - _velocities(cars.state, context.simulator)[:, None]
        cos, sin = cars.state[:, None, 2].cos(), cars.state[:, None, 2].sin()
        seen = [turned for vector in (way / self.reach, moves / self.speed) for turned in _turned(vector, cos, sin)]
        distance = torch.linalg.vector_norm(way, dim=-1)
        values = torch.stack([torch.ones_like(distance), *seen], dim=-1)
        near = (distance <= self.reach) & values.isfinite().all(dim=-1)
        values = torch.where(near[..., None], values, 0.0)
        order = torch.where(near, distance, WIDE).argsort(dim=1)[:, : self.count]
        told[:, : order.shape[1]] = values.gather(1, order[..., None].expand(-1, -1, VALUES_OF_A_CAR))
        return told.flatten(1)


@dataclass(frozen=True)
class Overtaking(FiniteTerm):
    """For each place won, and as much against each one lost: another car was ahead along the road, and is behind.

    Attributes:
        weight: of a place.
    """

    needs: ClassVar[tuple[str, ...]] = ("place", "others")
    weight: float = 1.0

    def __call__(self, step: StepContext) -> Tensor:
        """Places won less those lost in the step."""
        leads = _leads(step)
        if leads is None:
            return step.outcome.ranges.new_zeros(len(step.outcome.ranges))
        won, lost = places_changed(*leads, _lengths(step))
        return self.weight * (won - lost).float()


@dataclass(frozen=True)
class GapGained(FiniteTerm):
    """For each metre that the car gains on others near it along the road, and as much against each that it loses.

    Source: Wurman et al. 2022, "Outracing champion Gran Turismo drivers with deep reinforcement learning", where a car
    is near from 20 m behind to 40 m ahead.

    Attributes:
        weight: of a metre.
        behind: how far others may be behind, m.
        ahead: how far they may be ahead, m.
    """

    needs: ClassVar[tuple[str, ...]] = ("place", "others")
    weight: float = 0.5
    behind: float = 20.0
    ahead: float = 40.0

    def __call__(self, step: StepContext) -> Tensor:
        """Over all cars that are near before the step."""
        leads = _leads(step)
        if leads is None:
            return step.outcome.ranges.new_zeros(len(step.outcome.ranges))
        before, after = leads
        near = (before > -self.behind) & (before < self.ahead)
        return self.weight * torch.where(near, before - after, 0.0).sum(dim=1)


@dataclass(frozen=True)
class CarContact(FiniteTerm):
    """For touching another car.

    Source: Wurman et al. 2022: any contact, and running into the rear of another car by the square of the speed.

    Attributes:
        any: whoever was at fault.
        at_fault: added where the car drove with its front into the other one.
        squared: added then, times the square of the speed at which they came together, in m/s.
    """

    any: float = -4.0
    at_fault: float = 0.0
    squared: float = -0.1

    def __call__(self, step: StepContext) -> Tensor:
        """Of the first touch in the step."""
        contact = step.outcome.contact
        if contact is None:
            return step.outcome.ranges.new_zeros(len(step.outcome.ranges))
        at_fault = self.at_fault + self.squared * contact.closing_speed.square()
        return self.any * contact.touched + torch.where(contact.at_fault, at_fault, 0.0)


def _leads(step: StepContext) -> tuple[Tensor, Tensor] | None:
    """By how much each other car is ahead along the road before and after the step, [N, M], m; None without others."""
    before, after, length = step.before.cars, step.outcome.cars, _lengths(step)[:, None]
    if before.others is None or after.others is None:
        return None
    return lead(before, before.others, length), lead(after, after.others, length)


def places_changed(before: Tensor, after: Tensor, length: Tensor) -> tuple[Tensor, Tensor]:
    """How many places cars have won and lost in a step, [N] both, by how far others are ahead, [N, M], m.

    Args:
        before: the step.
        after: it.
        length: of the tracks, [N], m.
    """
    quarter = length[:, None] / 4  # a car that is further off is ahead and behind at once
    passes = (before.abs() < quarter) & (after.abs() < quarter)
    won, lost = passes & (before > 0) & (after <= 0), passes & (before <= 0) & (after > 0)
    return won.sum(dim=1), lost.sum(dim=1)


def lead(cars: CarState, others: Others, length: Tensor) -> Tensor:
    """By how much others are ahead, [N, M], m: behind where it is less than 0, and never more than half a lap.

    Args:
        cars: [N].
        others: of each.
        length: of the tracks, [N, 1], m.

    Raises:
        ConfigError: it is not known where on the road the cars are.
    """
    if cars.station is None:
        raise ConfigError('a term asks who is ahead; its class must say `needs = ("place", "others")`')
    return (others.station - cars.station[:, None] + length / 2) % length - length / 2


def _lengths(step: StepContext) -> Tensor:
    """Of the tracks, [N], m."""
    track = step.outcome.cars.track
    return step.simulator.routes.lengths.to(track.device)[track].float()


def _velocities(state: Tensor, simulator: Simulator, pace: Tensor | None = None) -> Tensor:
    """Of cars in these states, [..., S], in the frame of the road: [..., 2], m/s."""
    vehicle, course = simulator.vehicle, state[..., 2]
    names = vehicle.state_names
    if "speed" in names:
        speed = state[..., names.index("speed")]
        course = course + state[..., names.index("slip")] if "slip" in names else course
    else:
        speed = torch.full_like(course, vehicle.speed if isinstance(vehicle, ConstantSpeed) else 0.0)
        speed = speed if pace is None else pace * speed
    return torch.stack([speed * course.cos(), speed * course.sin()], dim=-1)


def _turned(vector: Tensor, cos: Tensor, sin: Tensor) -> tuple[Tensor, Tensor]:
    """How far vectors [..., 2] point ahead and to the left of a heading."""
    return cos * vector[..., 0] + sin * vector[..., 1], cos * vector[..., 1] - sin * vector[..., 0]
