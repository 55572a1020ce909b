"""Drives a policy without exploration and measures how well it drives.

Shapes: `B` cars, `T` steps, `R` rays, `O` values of an observation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.evaluation.asked import MOST_LAPS, MOST_STARTS
from carrl.evaluation.lap_timing import LapTiming
from carrl.evaluation.passing import Passing, PassingCounter
from carrl.evaluation.results import Rollout
from carrl.rows import Rows
from carrl.sim.driven import GRAVITY
from carrl.sim.simulator import CarState, Simulator
from carrl.task.checks import whole_number
from carrl.task.episode import EpisodeState
from carrl.task.reward import LAP_TERMS
from carrl.task.task import StepResult, Task, World
from carrl.tracks.track import Track

Policy = Callable[[Tensor], Tensor]
"""Observations [B, O] to actions [B, ...]."""


@dataclass(frozen=True)
class DrivenStep:
    """One step of cars that are driven side by side.

    Attributes:
        state: before it.
        observation: then, [B, O].
        action: that was chosen, [B, ...].
        after: what came of it.
        drives: which cars are still driving; the others have ended before, [B], bool.
        goes_on: which of these make another step, [B], bool.
    """

    state: EpisodeState
    observation: Tensor
    action: Tensor
    after: StepResult
    drives: Tensor
    goes_on: Tensor


class Recorder(Protocol):
    """Keeps what is driven, see `carrl.evaluation.drive_log`."""

    def begin(self, task: Task, policy: Policy) -> None:
        """All cars of a task start now."""

    def add(self, step: DrivenStep) -> None:
        """They make a step."""


TIME_LIMIT_LAPS = 2.0
"""A drive is stopped after the steps that this many laps of the centreline take; a sound policy needs about one."""
SLOWEST, PATIENCE_S = 10.0, 10.0
"""Cars whose speed varies may take so many times the steps that they take at full speed; but one that does not come to
its next gate by then, and these seconds, in which it can start from rest, stands still and is stopped."""

MOST_STEPS, MOST_READINGS = 2**18, 2**28
"""Of a drive, and steps times cars times rays, all of which are kept: about 1 GiB each."""
NO_POSES, NO_ACTIONS, NO_SPEEDS = np.empty((0, 0), np.float32), np.empty(0, np.int64), np.empty(0, np.float32)
"""The trajectory of a drive whose own is not kept."""
CARS_AT_ONCE = 256
"""As many tracks are driven together as this many cars allow, but at least one, so that memory stays bounded."""


def rollout_laps(
    world: World,
    simulator: Simulator,
    policy: Policy,
    starts: int = 1,
    kept: Callable[[Sequence[Rollout]], Sequence[int]] | None = None,
    laps: int = 1,
    recorder: Recorder | None = None,
) -> list[Rollout]:
    """Drives one lap of each of the simulator's tracks, in their order, from each of `starts` places.

    The places are spread evenly along the track, from the start line on; `kept`, `laps` and `recorder` are as in
    `rollout`.

    Raises:
        ConfigError: fewer than one start place or lap, or a drive takes too many steps.
    """
    starts = whole_number("starts", starts, 1, MOST_STARTS)
    stations = [torch.arange(starts) * track.length / starts for track in simulator.tracks]
    track = torch.arange(len(stations)).repeat_interleave(starts)
    return rollout(world, simulator, policy, torch.cat(stations), track, kept, laps, recorder)


class TrackEvaluator:
    """Drives policies on several tracks with the car and sensors of a world, some tracks at a time.

    Args:
        world: that says how a car drives; its own tracks do not matter.
        tracks: to be driven.
        starts: places on each track, spread evenly from its start line on.
        laps: as in `rollout`.
    """

    def __init__(self, world: World, tracks: Sequence[Track], starts: int, laps: int = 1) -> None:
        self._world, self._starts, self._laps = world, starts, laps
        cars = starts * (world.cars_per_world if world.opponents else 1)
        together = max(1, CARS_AT_ONCE // max(1, cars))
        groups = [tracks[begin : begin + together] for begin in range(0, len(tracks), together)]
        self._simulators = [world.simulator(group) for group in groups]

    def evaluate(
        self, policy: Policy, world: World | None = None, traced: bool = False, recorder: Recorder | None = None
    ) -> list[list[Rollout]]:
        """The rollouts on each track.

        Args:
            policy: what to do.
            world: of a policy that sees something else, with the same car.
            traced: keep the trajectories.
            recorder: keeps all that is driven.

        Raises:
            ConfigError: fewer than one start place.
        """
        found: list[list[Rollout]] = []
        kept = None if traced else lambda _: ()
        for simulator in self._simulators:
            rollouts = rollout_laps(world or self._world, simulator, policy, self._starts, kept, self._laps, recorder)
            found += [rollouts[begin : begin + self._starts] for begin in range(0, len(rollouts), self._starts)]
        return found


@dataclass
class _Moment(Rows):
    """What is kept of each moment of a rollout, [B, ...]; of several moments [T, B, ...]."""

    cars: CarState
    ranges: Tensor
    collided: Tensor
    ended: Tensor
    reward_terms: Tensor
    action: Tensor
    passing: Passing | None = None


def rollout(
    world: World,
    simulator: Simulator,
    policy: Policy,
    stations: Tensor,
    track: Tensor | None = None,
    kept: Callable[[Sequence[Rollout]], Sequence[int]] | None = None,
    laps: int = 1,
    recorder: Recorder | None = None,
) -> list[Rollout]:
    """Drives one lap from each of these places.

    Args:
        world: how a car drives and what counts; its own tracks do not matter.
        simulator: of the world, on the tracks to drive on.
        policy: what to do.
        stations: of the starts, m along the centreline, [B].
        track: which of the simulator's tracks each place is on, [B], int64; by default all are on the first.
        kept: given the drives without their trajectories, says which are to have them; by default all are.
        laps: driven in a row; where they are several, each drive is measured by the last of them, a flying lap, unless
            it ends before that begins. A drive ends with the last gate of its laps, which may stand somewhat before the
            line where it began; for the lap's time a car drives on to that line.
        recorder: keeps all that is driven.

    Raises:
        ConfigError: that takes too many steps, or a place is not a finite number.
    """
    laps = whole_number("laps", laps, 1, MOST_LAPS)
    stations = stations.double()
    if not stations.isfinite().all():
        raise ConfigError(f"stations are {shown(stations.tolist())}; they must be finite numbers of metres")
    task = world.evaluation_task(simulator, len(stations))
    cars = world.at_start(simulator, stations, track)
    limits, patience = laps * time_limits(simulator, cars), patience_of(simulator, cars)
    _check_limits(limits, simulator)
    timing = LapTiming(simulator, cars, stations, laps)
    counter = PassingCounter(simulator, cars) if cars.others else None
    now = task.start_at(cars)
    state, observation = now.state, now.observation
    if recorder is not None:
        recorder.begin(task, policy)
    moments = [_first_moment(task, state.last_action, cars)]
    may_stand_still = _has_speed(simulator)
    driving, last_gate = torch.ones_like(cars.next_gate, dtype=torch.bool), torch.zeros_like(cars.next_gate)
    for step in range(1, int(limits.max()) + 1):
        action = policy(observation)
        before, after, drove = (state, observation, action), task.step(state, action), driving
        state, observation = after.state, after.observation
        outcome = after.outcome
        ended = outcome.collided | after.terminated
        passing = counter.step(outcome) if counter else None
        moments.append(
            _Moment(outcome.cars, outcome.ranges, outcome.collided, ended, after.reward_terms, action, passing)
        )
        if may_stand_still:
            last_gate = torch.where(outcome.gates_passed > 0, step, last_gate)
            limits = torch.where(driving & (step - last_gate >= patience), step, limits)
        has_lapped = simulator.has_lapped(outcome.cars, laps)
        has_come_round = timing.has_ended(moments[-2].cars, outcome.cars, has_lapped)
        driving = driving & ~(ended | has_come_round) & (step < limits)
        if recorder is not None:
            recorder.add(DrivenStep(*before, after, drove, driving))
        if not driving.any():
            break
    return _sum_up(_Moment.stack(moments), limits, task, stations, kept, laps, timing)


def _first_moment(task: Task, action: Tensor, cars: CarState) -> _Moment:
    terms = cars.state.new_zeros(len(action), len(task.reward.term_names))
    nothing = torch.zeros_like(cars.next_gate, dtype=torch.bool)
    ranges = cars.state.new_zeros(len(action), task.simulator.sensor.rays)
    passing = Passing.none(cars) if cars.others else None
    return _Moment(cars, ranges, nothing, nothing, terms, action, passing)


def time_limits(simulator: Simulator, cars: CarState) -> Tensor:
    """Steps after which each car is stopped, [B], int64."""
    lap_steps = (simulator.routes.lengths / simulator.vehicle.step_length).ceil()
    laps = SLOWEST if _has_speed(simulator) else TIME_LIMIT_LAPS
    return (laps * lap_steps).round().long().to(cars.track.device)[cars.track]


def patience_of(simulator: Simulator, cars: CarState) -> Tensor:
    """Steps without a gate after which each car is stopped, [B], int64."""
    vehicle = simulator.vehicle
    if not _has_speed(simulator):
        return torch.full_like(cars.track, MOST_STEPS)
    gap_steps = simulator.routes.lengths / simulator.gate_counts.cpu() / vehicle.step_length
    return (SLOWEST * gap_steps + PATIENCE_S / vehicle.time_step).ceil().long().to(cars.track.device)[cars.track]


def _has_speed(simulator: Simulator) -> bool:
    return "speed" in simulator.vehicle.state_names


def _check_limits(limits: Tensor, simulator: Simulator) -> None:
    """Raises ConfigError for drives of more steps and readings than can be kept."""
    steps, rays = int(limits.max()), simulator.sensor.rays
    if steps > MOST_STEPS or steps * len(limits) * rays > MOST_READINGS:
        names = ", ".join(track.name for track in simulator.tracks[:3])
        raise ConfigError(
            f"a lap of track '{names}' may take {steps} steps with {rays} rays from each of {len(limits)} places, more "
            "than can be kept; make the car faster or its time step longer, or drive from fewer places"
        )


def _sum_up(
    course: _Moment,
    limits: Tensor,
    task: Task,
    stations: Tensor,
    kept: Callable[[Sequence[Rollout]], Sequence[int]] | None,
    laps: int,
    timing: LapTiming,
) -> list[Rollout]:
    """The drives of a course [T + 1, B]; a car's drive is what it did until it ended, if it moved on after that."""
    simulator = task.simulator
    ended = course.ended | simulator.has_lapped(course.cars, laps)
    lengths = torch.where(ended.any(0), ended.int().argmax(0), limits).minimum(limits)
    last = course.cars[lengths, torch.arange(len(lengths), device=lengths.device)]
    lap_reward, steering_reward = _earned(course, task)
    near_wall = task.reward.near_wall.is_near_wall(simulator.sensor.readings(course.ranges))
    steer = task.steer(course.action.flatten(0, 1)).view(course.collided.shape)
    progress = _progress(simulator, last, stations, laps).tolist()
    lapped = simulator.has_lapped(last, laps).tolist()
    flying = simulator.has_lapped(course.cars, laps - 1)
    begins = torch.where(flying.any(0), flying.int().argmax(0), 0).tolist()
    untouched = torch.where(course.ended.any(0), course.ended.int().argmax(0) - 1, limits).minimum(limits)
    sector_times = timing.sector_times(course.cars, untouched)
    drives = []
    for car, (begin, end) in enumerate(zip(begins, lengths.tolist(), strict=True)):
        begin = begin if begin < end else 0
        steps = end - begin
        motion = _motion(course.cars[begin : end + 1, car], simulator)
        distance = steps * simulator.vehicle.step_length if motion["distance"] is None else motion["distance"]
        near_wall_share = near_wall[begin + 1 : end + 1, car].double().mean().item() if task.reward.proximity else None
        drives.append(
            Rollout(
                start=stations[car].item(),
                lap_completed=lapped[car],
                collided=bool(course.collided[end, car]),
                progress=progress[car],
                lap_reward=lap_reward[begin:end, car].sum().item(),
                steering_reward=steering_reward[begin:end, car].sum().item(),
                lap_steps=steps,
                near_wall_share=near_wall_share,
                **_steering(steer[begin + 1 : end + 1, car], distance, bool(task.action.names)),
                **motion,
                **_grip(course.cars[begin + 1 : end + 1, car], simulator),
                **_passing(course, car, begin, end, progress[car] * laps - (laps - 1 if begin else 0)),
                sector_times=sector_times[car],
                poses=NO_POSES,
                ranges=NO_POSES,
                actions=NO_ACTIONS,
            )
        )
    for car in range(len(drives)) if kept is None else kept(drives):
        begin = lengths[car].item() - drives[car].lap_steps
        drives[car] = _with_trajectory(drives[car], course[begin:, car], simulator)
    return drives


def _progress(simulator: Simulator, cars: CarState, stations: Tensor, laps: int) -> Tensor:
    """Share of the laps driven, [B], in [0, 1]; of several as their gates tell."""
    if laps == 1:
        return simulator.progress(cars, stations)
    return (cars.gates_passed / (laps * simulator.gate_counts[cars.track])).double().clamp(max=1)


def _earned(course: _Moment, task: Task) -> tuple[Tensor, Tensor]:
    """What the lap and what the steering earned in each step, [T, B] both."""
    names = task.reward.term_names
    counted = LAP_TERMS if "gate" in names else names
    lap, steering = (task.reward.total(course.reward_terms[1:], each) for each in (counted, ("steering",)))
    return lap, steering


def _steering(steer: Tensor, distance: float, named: bool) -> dict[str, Any]:
    """How the wheel was turned in the steps [T] of so many metres, by actions that have names, or by numbers."""
    if not named:
        change = steer.diff().abs().double().mean().item() if len(steer) > 1 else 0.0
        return {"forward_share": None, "switches_per_100m": None, "reversals": None, "steering_change": change}
    switched = (steer[1:] != steer[:-1]).sum().item()
    return {
        "forward_share": (steer == 0).double().mean().item(),
        "switches_per_100m": 100 * switched / distance if distance else 0.0,
        "reversals": int((steer[1:] * steer[:-1] < 0).sum()),
    }


def _motion(cars: CarState, simulator: Simulator) -> dict[str, Any]:
    """How fast and how far a car drove between these moments [T + 1]; None for one whose speed never varies."""
    vehicle = simulator.vehicle
    if not _has_speed(simulator):
        return {"mean_speed": None, "distance": None}
    ways = cars.pose[:, :2].double().diff(dim=0)
    distance = torch.linalg.vector_norm(ways, dim=-1).sum().item()
    return {"mean_speed": distance / (len(ways) * vehicle.time_step), "distance": distance, "speeds": NO_SPEEDS}


def _grip(cars: CarState, simulator: Simulator) -> dict[str, Any]:
    """How much of the tyres' grip a car used after each of the steps [T]; nothing of one whose grip is not known."""
    names, friction = simulator.vehicle.state_names, getattr(simulator.vehicle, "friction", None)
    if friction is None or not {"acceleration", "lateral_acceleration"} <= set(names):
        return {}
    along, across = (cars.state[:, names.index(name)].double() for name in ("acceleration", "lateral_acceleration"))
    share = torch.hypot(along, across) / (friction * GRAVITY)
    return {"grip_mean": share.mean().item(), "grip_greatest": share.max().item()}


def _passing(course: _Moment, car: int, begin: int, end: int, lap_share: float) -> dict[str, Any]:
    """What happened between a car and others in these steps, so much of a lap; nothing of one that is alone."""
    if course.passing is None:
        return {}
    return course.passing.map(lambda values: values[begin + 1 : end + 1, car]).measures(lap_share)


def _with_trajectory(driven: Rollout, course: _Moment, simulator: Simulator) -> Rollout:
    """A drive with what a picture of it shows: of its own course [T + 1], which may go on after it."""
    cars, names = course.cars[: driven.lap_steps + 1], simulator.vehicle.state_names
    return replace(
        driven,
        poses=cars.pose.cpu().numpy().copy(),
        ranges=simulator.sense(cars).cpu().numpy(),
        actions=course.action[1 : driven.lap_steps + 1].cpu().numpy().copy(),
        speeds=cars.state[:, names.index("speed")].cpu().numpy().copy() if "speed" in names else None,
        others=cars.others.state[..., :3].cpu().numpy().copy() if cars.others else None,
    )
