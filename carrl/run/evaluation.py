"""Drives a policy without exploration and measures how well it drives.

Shapes: `B` cars, `T` steps, `R` rays.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.modules import QValueActor

from carrl.env.reward import Reward
from carrl.errors import ConfigError
from carrl.sim.simulator import Simulator, State
from carrl.sim.vehicle import Action

Policy = Callable[[Tensor], Tensor]
"""Observations [B, R] in 0..1, right to left, to values of `Action` [B]."""

TIME_LIMIT_LAPS = 2.0
"""A drive is stopped after the steps that this many laps of the centreline take; a sound policy needs about one."""


@dataclass(frozen=True)
class Drive:
    """One car's drive: until the lap is complete, it touches a wall, or the time is up.

    Attributes:
        start: station of the start, m along the centreline from the start line.
        lap_completed: all gates passed in order.
        collided: it touched a wall.
        progress: share of the lap driven, in [0, 1].
        lap_reward: sum of the rewards.
        lap_steps: steps driven.
        forward_share: share of the steps with the action forward.
        switches_per_100m: how often the action changed, per 100 m driven.
        near_wall_share: share of the steps with a sensor below the reward's proximity threshold.
        poses: before each step and after the last, [T + 1, 3].
        ranges: at each pose, [T + 1, R], m.
        actions: [T].
    """

    start: float
    lap_completed: bool
    collided: bool
    progress: float
    lap_reward: float
    lap_steps: int
    forward_share: float
    switches_per_100m: float
    near_wall_share: float
    poses: np.ndarray = field(repr=False)
    ranges: np.ndarray = field(repr=False)
    actions: np.ndarray = field(repr=False)

    def measures(self) -> dict[str, Any]:
        """The figures without the trajectory, ready for JSON."""
        arrays = ("poses", "ranges", "actions")
        return {name: value for name, value in vars(self).items() if name not in arrays}


def greedy_policy(network: QValueActor) -> Policy:
    """The action of the highest value."""

    @torch.no_grad()
    def act(observation: Tensor) -> Tensor:
        return network.module[0].module(observation).argmax(dim=-1)

    return act


def rule_policy(observation: Tensor) -> Tensor:
    """The hand-written baseline: steer to the side whose rays are longer in sum, unless they differ by little."""
    half = observation.shape[1] // 2
    to_left = observation[:, -half:].sum(-1) - observation[:, :half].sum(-1)
    dead_band = 0.05
    turn = torch.where(to_left > 0, int(Action.LEFT), int(Action.RIGHT))
    return torch.where(to_left.abs() > dead_band, turn, int(Action.FORWARD))


def random_policy(seed: int) -> Policy:
    """Actions drawn evenly, the same for the same seed."""
    generator = torch.Generator().manual_seed(seed)
    return lambda observation: torch.randint(len(Action), observation.shape[:1], generator=generator).to(
        observation.device
    )


def drive(simulator: Simulator, reward: Reward, policy: Policy, starts: int = 1) -> list[Drive]:
    """Drives one lap from each of `starts` places, spread evenly along the track from the start line on.

    Raises:
        ConfigError: fewer than one start place.
    """
    if starts < 1:
        raise ConfigError(f"starts is {starts}; it must be at least 1")
    stations = torch.arange(starts, dtype=torch.float64) * simulator.track.length / starts
    state = simulator.start(stations)
    trace = _Trace(state, simulator.sense(state.pose))
    observation = trace.ranges[0] / simulator.sensor.max_range
    for _ in range(round(TIME_LIMIT_LAPS * simulator.lap_steps)):
        action = policy(observation)
        outcome = simulator.step(trace.state, action)
        observation = outcome.ranges / simulator.sensor.max_range
        terms = reward.terms(observation, outcome.collided, outcome.gates_passed)
        ended = outcome.collided | (outcome.state.gates_passed >= simulator.track.gate_count)
        trace.append(action, outcome.state, outcome.ranges, terms.sum(-1), outcome.collided, ended)
        if not trace.driving.any():
            break
    progress = simulator.progress(trace.state, stations)
    return [trace.drive(car, simulator, reward, stations[car].item(), progress[car].item()) for car in range(starts)]


class _Trace:
    """What the cars did, step by step; a car that has ended stands still and adds nothing."""

    def __init__(self, state: State, ranges: Tensor) -> None:
        self.state = state
        self.driving = torch.ones_like(state.next_gate, dtype=torch.bool)
        self.collided = torch.zeros_like(self.driving)
        self.poses, self.ranges = [state.pose], [ranges]
        self.actions: list[Tensor] = []
        self.rewards: list[Tensor] = []
        self.lengths = torch.zeros_like(state.next_gate)

    def append(
        self, action: Tensor, state: State, ranges: Tensor, reward: Tensor, collided: Tensor, ended: Tensor
    ) -> None:
        moving = self.driving
        self.state = State(*(_where(moving, new, old) for new, old in zip(state, self.state, strict=True)))
        self.collided |= moving & collided
        self.lengths += moving
        self.actions.append(action)
        self.rewards.append(torch.where(moving, reward, 0.0))
        self.poses.append(self.state.pose)
        self.ranges.append(_where(moving, ranges, self.ranges[-1]))
        self.driving = moving & ~ended

    def drive(self, car: int, simulator: Simulator, reward: Reward, start: float, progress: float) -> Drive:
        steps = int(self.lengths[car])
        actions = torch.stack(self.actions)[:steps, car]
        ranges = torch.stack(self.ranges)[: steps + 1, car]
        switches = (actions[1:] != actions[:-1]).sum().item()
        return Drive(
            start=start,
            lap_completed=int(self.state.gates_passed[car]) >= simulator.track.gate_count,
            collided=bool(self.collided[car]),
            progress=progress,
            lap_reward=torch.stack(self.rewards)[:, car].sum().item(),
            lap_steps=steps,
            forward_share=(actions == Action.FORWARD).double().mean().item(),
            switches_per_100m=100 * switches / (steps * simulator.vehicle.step_length),
            near_wall_share=reward.is_near_wall(ranges[1:] / simulator.sensor.max_range).double().mean().item(),
            poses=torch.stack(self.poses)[: steps + 1, car].cpu().numpy(),
            ranges=ranges.cpu().numpy(),
            actions=actions.cpu().numpy(),
        )


def _where(mask: Tensor, new: Tensor, old: Tensor) -> Tensor:
    """The rows of `new` where the mask [B] holds, else those of `old`."""
    return torch.where(mask.view(-1, *[1] * (new.ndim - 1)), new, old)
