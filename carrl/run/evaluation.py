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

from carrl.agent.policy import GreedyPolicy
from carrl.env.observation import FIRST_ACTION, read
from carrl.env.random_streams import RandomStreams
from carrl.env.reward import Reward
from carrl.errors import ConfigError, shown
from carrl.sim.simulator import Outcome, Simulator, State
from carrl.sim.vehicle import Action

Policy = Callable[[Tensor, Tensor], Tensor]
"""Readings of the sensors [B, R], in 0..1, right to left, and last actions [B] to the next values of `Action` [B]."""

TIME_LIMIT_LAPS = 2.0
"""A drive is stopped after the steps that this many laps of the centreline take; a sound policy needs about one."""

MOST_STEPS, MOST_READINGS = 2**18, 2**28
"""Of a drive, and steps times cars times rays, all of which are kept: about 1 GiB each."""

SENSOR_SEED = 0
"""Of what a noisy sensor reads, so that the same policy drives the same drive again."""


@dataclass(frozen=True)
class Drive:
    """One car's drive: until the lap is complete, it touches a wall, or the time is up.

    Attributes:
        start: station of the start, m along the centreline from the start line.
        lap_completed: all gates passed in order.
        collided: it touched a wall.
        progress: share of the lap driven, in [0, 1].
        lap_reward: sum of the paper's rewards.
        steering_reward: sum of what turns and switches earn beside it.
        lap_steps: steps driven.
        forward_share: share of the steps with the action forward.
        switches_per_100m: how often the action changed, per 100 m driven.
        reversals: how often left followed right or right followed left, without a step forward between.
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
    steering_reward: float
    lap_steps: int
    forward_share: float
    switches_per_100m: float
    reversals: int
    near_wall_share: float
    poses: np.ndarray = field(repr=False)
    ranges: np.ndarray = field(repr=False)
    actions: np.ndarray = field(repr=False)

    def measures(self) -> dict[str, Any]:
        """The figures without the trajectory, ready for JSON."""
        arrays = ("poses", "ranges", "actions")
        return {name: value for name, value in vars(self).items() if name not in arrays}

    def state_dict(self) -> dict[str, Any]:
        """All of it, arrays as tensors."""
        return {
            name: torch.as_tensor(value) if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def from_state_dict(cls, state: dict[str, Any]) -> "Drive":
        """What `state_dict` told of."""
        values: dict[str, Any] = {
            name: value.numpy() if isinstance(value, Tensor) else value for name, value in state.items()
        }
        return cls(**values)


def greedy_policy(network: QValueActor, observe_action: bool) -> Policy:
    """The action of the highest value."""
    return GreedyPolicy([network], observe_action).actions


def rule_policy(readings: Tensor, _: Tensor) -> Tensor:
    """The hand-written baseline: steer to the side whose rays are longer in sum, unless they differ by little."""
    half = readings.shape[1] // 2
    to_left = readings[:, -half:].sum(-1) - readings[:, :half].sum(-1)
    dead_band = 0.05
    turn = torch.where(to_left > 0, int(Action.LEFT), int(Action.RIGHT))
    return torch.where(to_left.abs() > dead_band, turn, int(Action.FORWARD))


def random_policy(seed: int) -> Policy:
    """Actions drawn evenly, the same for the same seed."""
    generator = torch.Generator().manual_seed(seed)
    return lambda readings, _: torch.randint(len(Action), readings.shape[:1], generator=generator).to(readings.device)


def drive(simulator: Simulator, reward: Reward, policy: Policy, starts: int = 1) -> list[Drive]:
    """Drives one lap of each of the simulator's tracks, in their order, from each of `starts` places.

    The places are spread evenly along the track, from the start line on.

    Raises:
        ConfigError: fewer than one start place, or a drive takes too many steps.
    """
    if starts < 1:
        raise ConfigError(f"starts is {starts}; it must be at least 1")
    stations = [torch.arange(starts) * track.length / starts for track in simulator.tracks]
    track = torch.arange(len(stations)).repeat_interleave(starts)
    return drive_from(simulator, reward, policy, torch.cat(stations), track)


def drive_from(
    simulator: Simulator, reward: Reward, policy: Policy, stations: Tensor, track: Tensor | None = None
) -> list[Drive]:
    """Drives one lap from each of these places.

    Args:
        simulator: what moves the cars.
        reward: what a step earns.
        policy: what to do.
        stations: of the starts, m along the centreline, [B].
        track: which of the simulator's tracks each place is on, [B], int64; by default all are on the first.

    Raises:
        ConfigError: that takes too many steps, or a place is not a finite number.
    """
    stations = stations.double()
    if not stations.isfinite().all():
        raise ConfigError(f"stations are {shown(stations.tolist())}; they must be finite numbers of metres")
    state = simulator.start(stations, track)
    limits = _time_limits(simulator, state)
    _check_limits(limits, simulator)
    ranges = simulator.sense(state)
    streams = RandomStreams([SENSOR_SEED], len(stations))
    nothing = torch.zeros_like(state.next_gate)
    outcomes, actions = [Outcome(state, ranges, nothing.bool(), nothing)], [nothing + FIRST_ACTION]
    driving = ~nothing.bool()
    for step in range(1, int(limits.max()) + 1):
        action = policy(read(simulator.sensor, outcomes[-1].ranges, streams), actions[-1])
        outcome = simulator.step(outcomes[-1].state, action)
        actions.append(action)
        outcomes.append(outcome)
        driving &= ~_has_ended(outcome, simulator) & (step < limits)
        if not driving.any():
            break
    return _sum_up(_stack(outcomes), torch.stack(actions), limits, simulator, reward, stations)


def _time_limits(simulator: Simulator, state: State) -> Tensor:
    """Steps after which each car is stopped, [B], int64."""
    lap_steps = (simulator.routes.lengths / simulator.vehicle.step_length).ceil()
    return (TIME_LIMIT_LAPS * lap_steps).round().long().to(state.track.device)[state.track]


def _check_limits(limits: Tensor, simulator: Simulator) -> None:
    """Raises ConfigError for drives of more steps and readings than can be kept."""
    steps, rays = int(limits.max()), simulator.sensor.rays
    if steps > MOST_STEPS or steps * len(limits) * rays > MOST_READINGS:
        names = ", ".join(track.name for track in simulator.tracks[:3])
        raise ConfigError(
            f"a lap of track '{names}' may take {steps} steps with {rays} rays from each of {len(limits)} places, more "
            "than can be kept; make the car faster or its time step longer, or drive from fewer places"
        )


def _has_ended(outcome: Outcome, simulator: Simulator) -> Tensor:
    return outcome.collided | simulator.has_lapped(outcome.state)


def _stack(outcomes: list[Outcome]) -> Outcome:
    """The outcomes [B, ...] of T + 1 moments as one, [T + 1, B, ...]."""
    states, ranges, collided, passed = zip(*outcomes, strict=True)
    return Outcome(State(*map(torch.stack, zip(*states, strict=True))), *map(torch.stack, (ranges, collided, passed)))


def _sum_up(
    course: Outcome, actions: Tensor, limits: Tensor, simulator: Simulator, reward: Reward, stations: Tensor
) -> list[Drive]:
    """The drives of a course [T + 1, B]; a car's drive is what it did until it ended, if it moved on after that.

    Of the actions [T + 1, B] the first is the one that counts as before the start.
    """
    ended = _has_ended(course, simulator)
    lengths = torch.where(ended.any(0), ended.int().argmax(0), limits).minimum(limits)
    last = (lengths, torch.arange(len(lengths), device=lengths.device))
    readings = course.ranges[1:] / simulator.sensor.max_range
    near = reward.is_near_wall(readings)
    terms = reward.terms(readings, course.collided[1:], course.gates_passed[1:], actions[1:], actions[:-1])
    state = State(*(values[last] for values in course.state))
    progress, lapped = simulator.progress(state, stations).tolist(), simulator.has_lapped(state).tolist()
    drives = []
    for car, steps in enumerate(lengths.tolist()):
        driven = actions[1 : steps + 1, car]
        switched = driven[1:] != driven[:-1]
        turning = driven != Action.FORWARD
        drives.append(
            Drive(
                start=stations[car].item(),
                lap_completed=lapped[car],
                collided=bool(course.collided[steps, car]),
                progress=progress[car],
                lap_reward=reward.of_paper(terms)[:steps, car].sum().item(),
                steering_reward=reward.of_steering(terms)[:steps, car].sum().item(),
                lap_steps=steps,
                forward_share=(driven == Action.FORWARD).double().mean().item(),
                switches_per_100m=100 * switched.sum().item() / (steps * simulator.vehicle.step_length),
                reversals=int((switched & turning[1:] & turning[:-1]).sum()),
                near_wall_share=near[:steps, car].double().mean().item(),
                poses=course.state.pose[: steps + 1, car].cpu().numpy(),
                ranges=course.ranges[: steps + 1, car].cpu().numpy(),
                actions=driven.cpu().numpy(),
            )
        )
    return drives
