"""What a trained policy is compared with: a hand-written rule and chance, for every car and action map.

Shapes: `B` cars, `R` rays, `C` controls.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torchrl.data import Categorical

from carrl.errors import ConfigError
from carrl.evaluation.rollout import Policy
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import ActionMap, ContinuousActions, steer3
from carrl.task.episode import ObservationContext
from carrl.task.observation import Observation, Part, Rays, rays_only
from carrl.task.task import World

BRAKING = 3.0
"""With so much, m/s2, the rule can stop before the wall that it sees ahead."""
GAIN, PACE_GAIN, CALM = 1.0, 0.5, 20.0
"""Of the wheel, for the difference between left and right as a share of all that is seen, the less the faster it is
than the last of these, m/s; of the pedals, for a m/s."""

_PEDALS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "pedal": lambda push: push,
    "throttle": lambda push: 2 * push.clamp(min=0) - 1,
    "brake": lambda push: 2 * (-push).clamp(min=0) - 1,
}
"""What the rule does with each control when it pushes on, 1, or brakes, -1."""


def rule_of(world: World) -> tuple[World, Policy]:
    """The hand-written baseline for a world's car: the world as it sees it, and what it does there.

    Raises:
        ConfigError: it knows no such car.
    """
    observation, action, policy = rule_for(world.vehicle, world.sensor)
    return replace(world, observation=observation, action=action), policy


def rule_for(vehicle: VehicleModel, sensor: Sensor) -> tuple[Observation, ActionMap, Policy]:
    """What the hand-written baseline sees, what it chooses among, and what it does.

    Raises:
        ConfigError: it knows no such car.
    """
    if vehicle.control_names == ("steer",):
        return rays_only(), steer3(), rule_policy
    known = ("steer", *_PEDALS, "speed")
    if "speed" not in vehicle.state_names or not set(vehicle.control_names) <= set(known):
        raise ConfigError(
            f"the rule drives cars with steer, or with a speed and some of {', '.join(known)}; "
            f"{type(vehicle).__name__} has {', '.join(vehicle.control_names)}"
        )
    sees = Observation({"rays": Rays(), "speed": _Speed(vehicle.state_names.index("speed"))})
    top_speed = vehicle.step_length / vehicle.time_step
    driver = _PedalRule(sensor.max_range, vehicle.control_names, top_speed)
    return sees, ContinuousActions(vehicle.control_names), driver


def rule_policy(readings: Tensor) -> Tensor:
    """The hand-written baseline: steer to the side whose rays are longer in sum, unless they differ by little.

    Its actions are those of `steer3`: 0 straight on, 1 left, 2 right.
    """
    to_left = _to_left(readings)
    dead_band = 0.05
    turn = torch.where(to_left > 0, 1, 2)
    return torch.where(to_left.abs() > dead_band, turn, 0)


def random_policy(seed: int, action: ActionMap) -> Policy:
    """Actions drawn evenly, the same for the same seed."""
    generator, spec = torch.Generator().manual_seed(seed), action.spec

    def act(observation: Tensor) -> Tensor:
        cars = len(observation)
        if isinstance(spec, Categorical):
            return torch.randint(spec.n, (cars,), generator=generator).to(observation.device)
        return (2 * torch.rand(cars, *spec.shape, generator=generator) - 1).to(observation.device)

    return act


@dataclass(frozen=True)
class _Speed:
    """The entry of the vehicle's state that is its speed, m/s."""

    entry: int

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        return Part(name, 1, -math.inf, math.inf)

    def __call__(self, context: ObservationContext) -> Tensor:
        return context.state.cars.state[:, self.entry : self.entry + 1]


@dataclass(frozen=True)
class _PedalRule:
    """Steers to the side whose rays are longer in sum, in proportion, as fast as it could stop within what it sees.

    Attributes:
        sensor_range: m.
        control_names: of the car; `speed` is a share of its top speed.
        top_speed: m/s.
    """

    sensor_range: float
    control_names: tuple[str, ...]
    top_speed: float

    def __call__(self, observation: Tensor) -> Tensor:
        """The controls [B, C], of the rays' readings and the speed, [B, R + 1]."""
        readings, speed = observation[:, :-1], observation[:, -1]
        steer = GAIN * _to_left(readings) / readings.sum(-1).clamp(min=1e-6) * (CALM / speed.clamp(min=CALM))
        ahead = readings[:, readings.shape[1] // 2] * self.sensor_range
        wanted = (2 * BRAKING * ahead).sqrt()
        push = (PACE_GAIN * (wanted - speed)).clamp(-1, 1)
        controls = {name: pressed(push) for name, pressed in _PEDALS.items()}
        controls |= {"steer": steer.clamp(-1, 1), "speed": (wanted / self.top_speed).clamp(0, 1)}
        return torch.stack([controls[name] for name in self.control_names], dim=-1)


def _to_left(readings: Tensor) -> Tensor:
    """By how much the readings [B, R] on the left are more than those on the right, in sum, [B]."""
    half = readings.shape[1] // 2
    return readings[:, -half:].sum(-1) - readings[:, :half].sum(-1)
