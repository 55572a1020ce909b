"""The driving task in plain tensors: where an episode starts, what is seen, what a step earns, when the episode ends.

Every environment is a thin cover over it, and so is every evaluation.

Shapes: `N` cars driven side by side, `K` of them, `O` values of an observation.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.data import Categorical

from carrl.errors import ConfigError, shown
from carrl.rows import Rows, scalar
from carrl.sim.places import Place
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.traffic import MOST_CARS as MOST_CARS_PER_WORLD
from carrl.sim.traffic import Opponents, Traffic
from carrl.sim.vehicle import Vehicle, VehicleModel
from carrl.task.action import ActionMap, check_fits, fitted, steer3
from carrl.task.checks import instance, whole_number
from carrl.task.end import BumpIntoCars, End, EndAtContact, EndTerm, end_at_contact
from carrl.task.episode import EpisodeState, ObservationContext, Start, StartSampler, StepContext
from carrl.task.grid import GridSampler, behind_opponents
from carrl.task.observation import Observation, Part, rays_only
from carrl.task.random_streams import RandomStreams
from carrl.task.reward import Reward, paper_reward
from carrl.tracks.circuits import Circuits
from carrl.tracks.track import Track

Tracks = Track | str | Path | Sequence[Track | str | Path]

MOST_CARS = 2**20
MOST_READINGS = 2**26
"""Of all cars together at one moment: 256 MiB."""
UNLIMITED = 2**62
"""As `max_steps`: episodes are not truncated."""
SENSOR_SEED = 0
"""Of what a noisy sensor reads in an evaluation, so that the same policy drives the same way again."""


@dataclass
class EpisodeStart(Rows):
    """Episodes at their start.

    Attributes:
        state: of the episodes.
        observation: what the driver is told, [N, O], float32.
    """

    state: EpisodeState
    observation: Tensor


@dataclass
class StepResult(Rows):
    """What one step brought.

    Attributes:
        state: of the episodes after the step.
        observation: what the driver is told then, [N, O], float32.
        reward_terms: see `Reward`, [N, K], float32; the reward is their sum.
        terminated: the episode ended before its time, by default since the car touched a wall, [N], bool.
        truncated: the episode reached its last step without that, [N], bool.
        outcome: of the simulator.
    """

    state: EpisodeState
    observation: Tensor
    reward_terms: Tensor
    terminated: Tensor
    truncated: Tensor
    outcome: Outcome


class Task:
    """Episodes of any number of cars. It holds nothing of them but the random generators.

    Args:
        simulator: what moves the cars; its tracks are `start.variants` of those to drive on.
        cars: how many, N; so many for each seed.
        seeds: of the random generators; see `RandomStreams`.
        action: what an agent chooses among.
        observation: what it is told.
        reward: what a step earns.
        start: where episodes start.
        end: what ends them before their time; the simulator is of its `slide`.
        max_steps: length at which an episode is truncated, steps.

    Attributes:
        carried: names of what is to be kept from step to step beyond the usual: `station`, `stalled`, `seen`.

    Raises:
        ConfigError: a parameter is out of its range, or the action map does not fit the vehicle.
    """

    def __init__(
        self,
        simulator: Simulator,
        cars: int,
        seeds: Sequence[int | None] = (None,),
        *,
        action: ActionMap | None = None,
        observation: Observation | None = None,
        reward: Reward | None = None,
        start: Start | None = None,
        end: End | None = None,
        max_steps: int = UNLIMITED,
    ) -> None:
        """Seeds the generators."""
        cars = whole_number("env.num_envs", cars, 1, MOST_CARS)
        self.simulator, self.max_steps = simulator, whole_number("env.max_steps", max_steps, 1, 2**63 - 1)
        self.action, self.observation = fitted(action or steer3(), simulator.vehicle), observation or rays_only()
        self.reward, self.end = reward or paper_reward(), end or end_at_contact()
        needs = _needs(self.observation.terms, self.reward.terms, self.end.terms)
        self._needs_place, self._needs_others = "place" in needs, "others" in needs
        carried = {"place": "station", "stalled": "stalled", "seen": "seen"}
        self.carried = tuple(name for need, name in carried.items() if need in needs)
        self.cars = cars * len(seeds)
        readings = self.cars * simulator.sensor.rays
        if readings > MOST_READINGS:
            raise ConfigError(f"env.num_envs is {cars}; it must be so few that {readings} rays become {MOST_READINGS}")
        self._one, self._most_steps = scalar(1), scalar(self.max_steps)
        self.streams = RandomStreams(seeds, cars)
        self._traffic: Any = simulator if isinstance(simulator, Traffic) else None
        self._needs_others = self._needs_others and self.shares_worlds
        self._check_traffic(cars)
        sampler = GridSampler if isinstance(simulator, Traffic) else StartSampler
        self._sampler = sampler(start or Start(), simulator, cars, len(seeds))  # type: ignore[arg-type]

    @property
    def observation_parts(self) -> tuple[Part, ...]:
        """Where each term stands in an observation."""
        return self.observation.parts(self.simulator.sensor, self.action)

    @property
    def observation_bounds(self) -> tuple[Tensor, Tensor]:
        """The least and the largest value of each entry of an observation, [O] and [O], float32."""
        parts = self.observation_parts
        widths = torch.tensor([part.width for part in parts])
        low, high = (torch.tensor(bounds) for bounds in zip(*((part.low, part.high) for part in parts), strict=True))
        return low.repeat_interleave(widths), high.repeat_interleave(widths)

    @property
    def starts_alike(self) -> bool:
        """Whether every episode of a car starts in the same way."""
        return self._sampler.is_always_the_same and self.simulator.sensor.is_exact

    @property
    def has_opponents(self) -> bool:
        """Whether the cars' states have others, which are no rows."""
        return self._traffic is not None and not self.shares_worlds

    @property
    def may_end_otherwise(self) -> bool:
        """Whether something else than a wall may end an episode."""
        return self.end.has_others or (self._traffic is not None and self.end.bump is None)

    def collided(self, state: EpisodeState) -> Tensor | None:
        """Where touching a wall ended the episode, [N, 1], bool; None where nothing else may end one."""
        if not self.may_end_otherwise or state.contact is None:
            return None
        return state.contact[:, None] if self.end.slide is None else torch.zeros_like(state.contact[:, None])

    def trial_cars(self, streams: RandomStreams) -> CarState:
        """Some cars at a start, drawn from streams of their own, to try the task's terms on."""
        if self._traffic is None:
            return self.simulator.start(torch.zeros(2))
        return self._sampler(streams, torch.ones(self.cars, dtype=torch.bool))

    @property
    def shares_worlds(self) -> bool:
        """Whether several of these cars are in the same world."""
        return self._traffic is not None and self._traffic.rows_per_world > 1

    def _check_traffic(self, cars: int) -> None:
        """Raises ConfigError unless the cars make up whole worlds."""
        if self._traffic is not None and cars % self._traffic.rows_per_world:
            raise ConfigError(
                f"env.num_envs is {cars}; it must be a multiple of env.cars_per_world, "
                f"{self._traffic.rows_per_world}, unless there are opponents"
            )

    def start(self, wanted: Tensor | None = None, now: CarState | None = None) -> EpisodeStart:
        """New episodes of the `wanted` cars, [N] bool with K of them true; of all by default.

        Args:
            wanted: which.
            now: where all cars are, [N], if some of those that start share a world with some that do not.

        Returns:
            Those alone, K instead of N.
        """
        wanted = torch.ones(self.cars, dtype=torch.bool) if wanted is None else wanted.cpu()
        if not self.shares_worlds:
            return self.start_at(self._sampler(self.streams, wanted), wanted)
        cars = self._sampler(self.streams, wanted, now)  # type: ignore[call-arg]
        return self._start_among(cars, wanted, now)

    def _start_among(self, cars: CarState, wanted: Tensor, now: CarState | None) -> EpisodeStart:
        """New episodes of the `wanted` cars where they are among all [N], and see each other."""
        state, place = self.begin_at(cars)
        everyone = state.cars if now is None or bool(wanted.all()) else now.replacing(wanted, state.cars)
        return self._told_among(everyone, state, place, wanted)

    def tell(self, state: EpisodeState, pace: Tensor | None = None) -> Tensor:
        """What the drivers of all cars of some worlds are told where they are, [N, O].

        Args:
            state: of the cars, with the stations that they had a step before if those are known; `seen` is what they
                were told then, None at a start.
            pace: share of their speed at which they drive, [N]; None where all drive at full speed.
        """
        cars = replace(state.cars, others=None)
        place = self.simulator.place(cars) if self._needs_place else None
        cars = cars if place is None else replace(cars, station=place.station)
        return self._told_among(cars, replace(state, cars=cars), place, pace=pace).observation

    def _told_among(
        self,
        everyone: CarState,
        state: EpisodeState,
        place: Place | None,
        wanted: Tensor | None = None,
        pace: Tensor | None = None,
    ) -> EpisodeStart:
        """What the drivers of the `wanted` cars, [N] bool, all by default, are told among everyone [N]."""
        ranges, on_car = self._traffic.look(everyone)
        others = self._traffic.neighbours(everyone, pace) if self._needs_others else None
        if wanted is not None:
            ranges, on_car, others = ranges[wanted], on_car[wanted], others if others is None else others[wanted]
        if others is not None:
            state = replace(state, cars=replace(state.cars, others=others))
        observation = self._observe(state, ranges, place, state.seen, wanted, on_car)
        return EpisodeStart(self._remembering(state, observation), observation)

    def start_at(self, cars: CarState, wanted: Tensor | None = None) -> EpisodeStart:
        """New episodes of cars that are here, [K], which are the `wanted` ones of all [N]; of all by default."""
        state, place = self.begin_at(cars)
        ranges, on_car = self._traffic.look(cars) if self._traffic else (self.simulator.sense(cars), None)
        observation = self._observe(state, ranges, place, wanted=wanted, on_car=on_car)
        return EpisodeStart(self._remembering(state, observation), observation)

    def begin_at(self, cars: CarState) -> tuple[EpisodeState, Place | None]:
        """The state of episodes that begin here, and where on the road the cars are, if a term needs that."""
        first = self.action.first.to(self.simulator.device)
        step = torch.zeros_like(cars.next_gate)
        place = self.simulator.place(replace(cars, station=None)) if self._needs_place else None
        cars = cars if place is None else replace(cars, station=place.station)
        stalled = step.clone() if "stalled" in self.carried else None
        contact = torch.zeros_like(step, dtype=torch.bool)
        last_action = first.expand(len(step), *first.shape).clone()
        return EpisodeState(cars, step, last_action, None, stalled, contact), place

    def step(self, state: EpisodeState, action: Tensor) -> StepResult:
        """Drives every car by one time step: actions [N] or [N, C], within the action map's spec.

        The reward counts true distances, whatever the sensor reads.
        """
        step = self.drive(state, action)
        outcome = step.outcome
        terms, terminated = self.reward(step), self.end(step)
        stalled = self.end.stalled(step) if "stalled" in self.carried else None
        after = EpisodeState(outcome.cars, state.step + self._one, action, None, stalled, outcome.collided)
        truncated = (after.step >= self._most_steps) > terminated  # the one without the other
        observation = self._observe(after, outcome.ranges, outcome.place, state.seen, on_car=outcome.on_car)
        return StepResult(self._remembering(after, observation), observation, terms, terminated, truncated, outcome)

    def drive(self, state: EpisodeState, action: Tensor) -> StepContext:
        """The same before it is judged; it says where on the road the cars are, if a term needs that."""
        outcome = self.simulator.step(state.cars, self.action.controls(action))
        if self._needs_place:
            place = self.simulator.place(replace(outcome.cars, station=state.cars.station))
            outcome = replace(outcome, cars=replace(outcome.cars, station=place.station), place=place)
        if self._needs_others:
            state = replace(state, cars=self._with_others(state.cars))
            outcome = replace(outcome, cars=self._with_others(outcome.cars))
        return StepContext(state, action, outcome, self.simulator, self.action)

    def _with_others(self, cars: CarState) -> CarState:
        """The cars, each with the others of its world, which are rows, too."""
        return replace(cars, others=self._traffic.neighbours(cars))

    def _remembering(self, state: EpisodeState, observation: Tensor) -> EpisodeState:
        """The state with the observation, if a term looks back at it."""
        return replace(state, seen=observation) if "seen" in self.carried else state

    def steer(self, action: Tensor) -> Tensor:
        """How far actions [N] or [N, C] turn the wheel, [N], -1 to 1; 0 for a car that is not steered."""
        controls, names = self.action.controls(action), self.simulator.vehicle.control_names
        return controls[:, names.index("steer")] if "steer" in names else torch.zeros_like(controls[:, 0])

    def random_action(self) -> Tensor:
        """An action for every car, drawn evenly from the cars' own streams."""
        spec = self.action.spec
        if isinstance(spec, Categorical):
            return self.streams.integers(spec.n).to(self.simulator.device)
        drawn = self.streams.uniform(*spec.shape).to(self.simulator.device)
        return (spec.low + (spec.high - spec.low) * drawn).float()

    def _observe(
        self,
        state: EpisodeState,
        ranges: Tensor,
        place: Place | None,
        seen: Tensor | None = None,
        wanted: Tensor | None = None,
        on_car: Tensor | None = None,
    ) -> Tensor:
        return self.observation(
            ObservationContext(state, ranges, self.simulator, self.action, self.streams, wanted, place, seen, on_car)
        )


def _needs(*groups: Mapping[str, Any]) -> set[str]:
    """What any of the terms needs that costs time."""
    return {need for terms in groups for term in terms.values() for need in getattr(term, "needs", ())}


def make_task(
    track: Tracks = "paper",
    num_envs: int = 1,
    seeds: Sequence[int | None] = (None,),
    device: torch.device | str = "cpu",
    *,
    vehicle: VehicleModel | None = None,
    sensor: Sensor | None = None,
    action: ActionMap | None = None,
    observation: Observation | None = None,
    reward: Reward | None = None,
    start: Start | None = None,
    end: End | None = None,
    cars_per_world: int = 1,
    opponents: Opponents | None = None,
    max_steps: int = 1000,
) -> Task:
    """A task with a simulator of its own; the arguments are those of `TrackEnv`.

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter is of another type or out of its range.
    """
    num_envs = whole_number("env.num_envs", num_envs, 1, MOST_CARS)
    start = instance("start", start, Start) or Start()
    vehicle = instance("vehicle", vehicle, VehicleModel) or Vehicle()  # type: ignore[type-abstract]
    sensor = instance("sensor", sensor, Sensor) or Sensor()
    end = instance("end", end, End) or end_at_contact()
    tracks = start.variants([each if isinstance(each, Track) else Track.load(each) for each in _listed(track)])
    cars_per_world = whole_number("env.cars_per_world", cars_per_world, 1, MOST_CARS_PER_WORLD)
    opponents = instance("opponents", opponents, Opponents)  # type: ignore[type-abstract]
    if cars_per_world == 1 and opponents is not None:
        raise ConfigError("there are opponents, and env.cars_per_world is 1; set it to 2 or more")
    parts = tracks, vehicle, sensor, device
    simulator = (
        Simulator(*parts, slide=end.slide)
        if cars_per_world == 1
        else Traffic(*parts, slide=end.slide, cars_per_world=cars_per_world, bump=end.bump, opponents=opponents)
    )
    return Task(
        simulator,
        num_envs,
        seeds,
        action=action,
        observation=instance("observation", observation, Observation),
        reward=instance("reward", reward, Reward),
        start=start,
        end=end,
        max_steps=max_steps,
    )


def _listed(track: Tracks) -> Sequence[Track | str | Path]:
    """One track or several as a list, whose items alone are checked."""
    listed = [track] if isinstance(track, Track | str | Path) or not isinstance(track, Iterable) else list(track)
    for each in listed:
        if not isinstance(each, Track | str | Path):
            raise ConfigError(
                f"track is {shown(each)}; it must be a Track, a built-in track's name or a file, or a list"
            )
    return listed


@dataclass(frozen=True)
class World:
    """The parts that make tasks alike, wherever they are driven.

    Attributes:
        circuits: to learn on, and to try networks out on.
        vehicle: the car.
        sensor: its rays.
        action: what an agent chooses among.
        observation: what it is told.
        reward: what a step earns.
        opponents: what drives the other cars of a world; None where a car is alone, or all of them learn.
        cars_per_world: with the opponents.
        gap: between two cars at the start, at least, in lengths of the car.
        bump: as in `Traffic`; None where touching another car ends an episode.
    """

    circuits: Circuits
    vehicle: VehicleModel
    sensor: Sensor
    action: ActionMap
    observation: Observation
    reward: Reward
    opponents: Opponents | None = None
    cars_per_world: int = 1
    gap: float = 4.0
    bump: float | None = None

    def __post_init__(self) -> None:
        """Raises ConfigError unless the actions fit the vehicle and the number of cars is one."""
        check_fits(self.action, self.vehicle)
        whole_number("env.cars_per_world", self.cars_per_world, 1, MOST_CARS_PER_WORLD)

    @property
    def track(self) -> Track:
        """The first track to learn on: the only one, if there is one."""
        return self.circuits.training[0]

    @property
    def opponents_files(self) -> Sequence[Path]:
        """What the opponents were read from."""
        return () if self.opponents is None else self.opponents.files

    @property
    def observation_size(self) -> int:
        """Values of an observation."""
        return sum(part.width for part in self.observation.parts(self.sensor, self.action))

    @property
    def end(self) -> End:
        """Of an evaluation: touching a wall, or another car unless it is known what that does to a car's speed."""
        ends: dict[str, EndTerm] = {"contact": EndAtContact()}
        if self.bump is not None:
            ends["cars"] = BumpIntoCars(self.bump)
        return End(ends)

    def simulator(self, tracks: Track | Sequence[Track], device: torch.device | str = "cpu") -> Simulator:
        """The car and its rays on these tracks, among the opponents if there are any."""
        parts = tracks, self.vehicle, self.sensor, device
        if self.opponents is None:
            return Simulator(*parts)
        return Traffic(*parts, cars_per_world=self.cars_per_world, bump=self.bump, opponents=self.opponents)

    def at_start(self, simulator: Simulator, stations: Tensor, track: Tensor | None) -> CarState:
        """Cars at these stations, [N], m, on these of the simulator's tracks, behind the opponents if there are any.

        At the same place of the same track the opponents are always the same, whatever is driven beside.
        """
        cars = simulator.start(stations, track)
        if not isinstance(simulator, Traffic):
            return cars
        lengths = simulator.routes.lengths[cars.track.cpu()]
        places = torch.stack([stations.cpu() % lengths, lengths], dim=1)
        seeds = [[SENSOR_SEED, *map(round, place)] for place in (1000 * places).tolist()]
        shape = simulator.cars_per_world - 1, 3
        draws = torch.from_numpy(np.stack([np.random.default_rng(seed).random(shape) for seed in seeds]))
        return behind_opponents(simulator, cars, stations, self.gap, draws)

    def evaluation_task(self, simulator: Simulator, cars: int) -> Task:
        """Episodes of so many cars, without a limit of steps, with this world's `end`."""
        parts = {"action": self.action, "observation": self.observation, "reward": self.reward}
        return Task(simulator, cars, [SENSOR_SEED], end=self.end, **parts)  # type: ignore[arg-type]
