"""The driving task in plain tensors: where an episode starts, what a step earns, when the episode ends.

Every environment of this package is a thin cover over it.

Shapes: `N` cars driven side by side, `K` of them, `R` rays, `T` tracks.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from carrl.env.checks import flag, instance, number, whole_number
from carrl.env.observation import FIRST_ACTION, observation_size, observe, read
from carrl.env.random_streams import RandomStreams
from carrl.env.reward import Reward
from carrl.errors import ConfigError, shown
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator, State
from carrl.sim.track import Track
from carrl.sim.vehicle import Vehicle, VehicleModel

Tracks = Track | str | Path | Sequence[Track | str | Path]

MOST_CARS = 2**20
MOST_READINGS = 2**26
"""Of all cars together at one moment: 256 MiB."""


class Situation(NamedTuple):
    """All that an episode is at one moment.

    Attributes:
        state: of the simulator.
        step: steps since the start, [N], int64.
        last_action: of the step before, [N], int64; forward at the start.
        observation: what the driver is told, [N, R] or, with the last action, [N, R + 3], float32.
    """

    state: State
    step: Tensor
    last_action: Tensor
    observation: Tensor

    def only(self, wanted: Tensor) -> "Situation":
        """That of the `wanted` cars alone, [N] bool with K of them true."""
        index = wanted.nonzero()[:, 0]
        return _situation([each[index] for each in _fields(self)])

    def replacing(self, wanted: Tensor, others: "Situation") -> "Situation":
        """This one, but with the K `others` in the places of the `wanted` cars, [N] bool with K of them true."""
        index = wanted.nonzero()[:, 0]
        pairs = zip(_fields(self), _fields(others), strict=True)
        return _situation([each.index_copy(0, index, other) for each, other in pairs])


class Transition(NamedTuple):
    """What one step brought.

    Attributes:
        situation: after the step.
        reward_terms: see `carrl.env.reward`, [N, 4], with shaping [N, 5], float32; the reward is their sum.
        terminated: the car touched a wall, [N], bool.
        truncated: the episode reached its last step without that, [N], bool.
    """

    situation: Situation
    reward_terms: Tensor
    terminated: Tensor
    truncated: Tensor


class Task:
    """Episodes of any number of cars. It holds nothing of them but the random generators.

    Args:
        track: what all cars drive on; or several tracks, of which the cars get one each in turn.
        num_envs: how many cars; so many for each seed.
        seeds: of the random generators; see `RandomStreams`.
        device: where the tensors live.
        vehicle: the car.
        sensor: its rays.
        reward: what a step earns.
        max_steps: length at which an episode is truncated, steps.
        random_start: start anywhere along the centreline instead of on the start line.
        start_offset: how far beside the centreline an episode may start, as a share of the room there, 0..1.
        heading_jitter: how far an episode's first heading may deviate from the driving direction, degrees.
        sample_track: draw each car's track anew for each episode.
        mirrored: drive every other episode, by chance, on the mirror image of the track.
        reversed: drive every other episode, by chance, the other way round.
        observe_action: append the last action to the observation, one-hot.

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter is of another type or out of its range.
    """

    def __init__(
        self,
        track: Tracks = "paper",
        num_envs: int = 1,
        seeds: Sequence[int | None] = (None,),
        device: torch.device | str = "cpu",
        *,
        vehicle: VehicleModel | None = None,
        sensor: Sensor | None = None,
        reward: Reward | None = None,
        max_steps: int = 1000,
        random_start: bool = False,
        start_offset: float = 0.0,
        heading_jitter: float = 0.0,
        sample_track: bool = False,
        mirrored: bool = False,
        reversed: bool = False,
        observe_action: bool = False,
    ) -> None:
        """Builds the simulator."""
        num_envs = whole_number("env.num_envs", num_envs, 1, MOST_CARS)
        self.max_steps = whole_number("env.max_steps", max_steps, 1, 2**63 - 1)
        self.random_start = flag("env.random_start", random_start)
        self.observe_action = flag("env.observe_action", observe_action)
        self.start_offset = number("env.start_offset", start_offset, 0, 1, "a share between 0 and 1")
        degrees = number("env.heading_jitter", heading_jitter, 0, 180, "between 0 and 180 degrees")
        self.heading_jitter = math.radians(degrees)
        self.reward = instance("reward", reward, Reward) or Reward()
        vehicle = instance("vehicle", vehicle, VehicleModel) or Vehicle()  # type: ignore[type-abstract]
        sensor = instance("sensor", sensor, Sensor) or Sensor()
        bases = [each if isinstance(each, Track) else Track.load(each) for each in _listed(track)]
        mirrored, reversed = flag("env.mirrored", mirrored), flag("env.reversed", reversed)
        tracks = [variant for base in bases for variant in _variants(base, mirrored, reversed)]
        self.simulator = Simulator(tracks, vehicle, sensor, device)
        self.cars = num_envs * len(seeds)
        readings = self.cars * self.simulator.sensor.rays
        if readings > MOST_READINGS:
            raise ConfigError(
                f"env.num_envs is {num_envs}; it must be so few that {readings} rays become {MOST_READINGS}"
            )
        self.streams = RandomStreams(seeds, num_envs)
        self._variants = len(tracks) // max(1, len(bases))
        self._samples_track = flag("env.sample_track", sample_track) and len(bases) > 1
        self._own_base = (torch.arange(num_envs) % len(bases)).repeat(len(seeds))

    @property
    def observation_size(self) -> int:
        """Values of an observation."""
        return observation_size(self.simulator.sensor.rays, self.observe_action)

    @property
    def starts_alike(self) -> bool:
        """Whether every episode of a car starts in the same situation."""
        by_chance = self.random_start or self.start_offset or self.heading_jitter
        return not (by_chance or self._samples_track or self._variants > 1) and self.simulator.sensor.is_exact

    def start(self, wanted: Tensor | None = None) -> Situation:
        """New episodes of the `wanted` cars, [N] bool with K of them true; of all by default.

        Returns:
            Their situations alone, K instead of N.
        """
        wanted = torch.ones(self.cars, dtype=torch.bool) if wanted is None else wanted.cpu()
        place = self.streams.uniform(wanted=wanted) if self.random_start else torch.zeros(self.cars).double()
        track = self._draw_tracks(wanted)
        state = self.simulator.start(
            stations=(place * self.simulator.routes.lengths[track])[wanted],
            track=track[wanted],
            offset=self._draw_within(self.start_offset, wanted),
            heading=self._draw_within(self.heading_jitter, wanted),
        )
        readings = read(self.simulator.sensor, self.simulator.sense(state), self.streams, wanted)
        last_action = torch.full_like(state.next_gate, FIRST_ACTION)
        observation = observe(readings, last_action, self.observe_action)
        return Situation(state, torch.zeros_like(last_action), last_action, observation)

    def step(self, situation: Situation, action: Tensor) -> Transition:
        """Drives every car by one time step: actions [N], int64.

        The reward counts true distances, whatever the sensor reads.
        """
        outcome = self.simulator.step(situation.state, action)
        truth = outcome.ranges / self.simulator.sensor.max_range
        terms = self.reward.terms(truth, outcome.collided, outcome.gates_passed, action, situation.last_action)
        if self.reward.approach:
            # A car whose pose is not finite, which has collided, earns the collision alone.
            before = self.simulator.gate_distance(situation.state).nan_to_num(0, 0, 0)
            after = self.simulator.gate_distance(outcome.state)
            terms = torch.cat([terms, self.reward.shaping(before, after, outcome.collided)[:, None]], dim=-1)
        readings = read(self.simulator.sensor, outcome.ranges, self.streams)
        step = situation.step + 1
        truncated = (step >= self.max_steps) & ~outcome.collided
        observation = observe(readings, action, self.observe_action)
        now = Situation(outcome.state, step, action, observation)
        return Transition(now, terms, outcome.collided, truncated)

    def _draw_tracks(self, wanted: Tensor) -> Tensor:
        """Which track each car drives on, [N]."""
        base = self._own_base
        if self._samples_track:
            bases = len(self.simulator.tracks) // self._variants
            base = (self.streams.uniform(wanted=wanted) * bases).long()
        if self._variants == 1:
            return base
        return base * self._variants + (self.streams.uniform(wanted=wanted) * self._variants).long()

    def _draw_within(self, most: float, wanted: Tensor) -> Tensor | None:
        """Numbers between -most and most, [K]."""
        return most * (2 * self.streams.uniform(wanted=wanted)[wanted] - 1) if most else None


def _fields(situation: Situation) -> tuple[Tensor, ...]:
    """Its tensors, [N, ...] each."""
    return (*situation.state, *situation[1:])


def _situation(fields: Sequence[Tensor]) -> Situation:
    state = len(State._fields)
    return Situation(State(*fields[:state]), *fields[state:])


def _listed(track: Tracks) -> Sequence[Track | str | Path]:
    """One track or several as a list, whose items alone are checked."""
    listed = [track] if isinstance(track, Track | str | Path) or not isinstance(track, Iterable) else list(track)
    for each in listed:
        if not isinstance(each, Track | str | Path):
            raise ConfigError(
                f"track is {shown(each)}; it must be a Track, a built-in track's name or a file, or a list"
            )
    return listed


def _variants(track: Track, mirrored: bool, reversed_: bool) -> list[Track]:
    """The track itself, and what else it may be driven as."""
    variants = [track, track.mirrored()] if mirrored else [track]
    return variants + [each.reversed() for each in variants] if reversed_ else variants
