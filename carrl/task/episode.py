"""Episodes: where they start, their state at one moment, and one step from a moment to the next.

Terms of a task are functions of these.

Shapes: `N` cars, of which `K` are wanted; `S` entries of a vehicle's state, `C` controls, `R` rays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.rows import Rows
from carrl.sim.places import Place
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import ActionMap
from carrl.task.checks import flag, number
from carrl.task.random_streams import RandomStreams
from carrl.tracks.track import Track

MOST_SPEED = 1000.0
"""Of a car at its start, m/s."""
ORDERS = ("random", "first", "last")


@dataclass(frozen=True)
class Start:
    """On the start line or somewhere else, on which of the tracks, and which way round.

    Attributes:
        anywhere: start anywhere along the centreline instead of on the start line.
        offset: how far beside the centreline, at most, as a share of the room there, 0..1.
        heading_jitter: how far the first heading may deviate from the driving direction, degrees.
        sample_track: draw each car's track anew for each episode.
        mirrored: drive every other episode, by chance, on the mirror image of the track.
        reversed: drive every other episode, by chance, the other way round.
        speed: of a vehicle whose speed varies, m/s.
        speed_spread: by how much it may be more or less, m/s; at least 0 in any case.
        gap: between two cars of a world, at least, in lengths of the car.
        order: place of the car that learns among its opponents: `random`, `first` or `last`.
    """

    anywhere: bool = False
    offset: float = 0.0
    heading_jitter: float = 0.0
    sample_track: bool = False
    mirrored: bool = False
    reversed: bool = False
    speed: float = 0.0
    speed_spread: float = 0.0
    gap: float = 4.0
    order: str = "random"

    def __post_init__(self) -> None:
        """Raises ConfigError for a value out of its range."""
        number("start.offset", self.offset, 0, 1, "a share between 0 and 1")
        number("start.gap", self.gap, 2, 1000, "between 2 and 1000 lengths of the car")
        if self.order not in ORDERS:
            raise ConfigError(f"start.order is {shown(self.order)}; it must be {', '.join(ORDERS)}")
        number("start.heading_jitter", self.heading_jitter, 0, 180, "between 0 and 180 degrees")
        for name in ("speed", "speed_spread"):
            number(f"start.{name}", getattr(self, name), 0, MOST_SPEED, f"between 0 and {MOST_SPEED:g} m/s")
        for name in ("anywhere", "sample_track", "mirrored", "reversed"):
            flag(f"start.{name}", getattr(self, name))

    def variants(self, tracks: Sequence[Track]) -> list[Track]:
        """The tracks [T], each followed by what else it may be driven as."""
        return [variant for track in tracks for variant in self._variants(track)]

    def _variants(self, track: Track) -> list[Track]:
        variants = [track, track.mirrored()] if self.mirrored else [track]
        return variants + [each.reversed() for each in variants] if self.reversed else variants


class StartSampler:
    """Draws starts on the tracks of a simulator.

    Args:
        start: what to draw.
        simulator: whose tracks are `start.variants` of some tracks.
        cars: how many, N, of each of so many seeds.
        seeds: how many.

    Raises:
        ConfigError: a speed is asked for, and the vehicle has but one, or does not drive that fast.
    """

    def __init__(self, start: Start, simulator: Simulator, cars: int, seeds: int) -> None:
        if (start.speed or start.speed_spread) and "speed" not in simulator.vehicle.state_names:
            name = "speed" if start.speed else "speed_spread"
            raise ConfigError(
                f"start.{name} is {getattr(start, name)}; the vehicle {type(simulator.vehicle).__name__} has no speed "
                "in its state that an episode could start with, so it must be 0"
            )
        if start.speed or start.speed_spread:  # that it is refused now, and not when it is drawn
            simulator.vehicle.initial_state(torch.zeros(1, 3), torch.tensor([start.speed + start.speed_spread]))
        self._start, self._simulator = start, simulator
        self._variants = (1 + start.mirrored) * (1 + start.reversed)
        self._bases = len(simulator.tracks) // self._variants
        self._samples_track = start.sample_track and self._bases > 1
        self._own_base = (torch.arange(cars) % self._bases).repeat(seeds)

    @property
    def is_always_the_same(self) -> bool:
        """Whether every episode of a car starts in the same place."""
        start = self._start
        by_chance = start.anywhere or start.offset or start.heading_jitter or start.speed_spread
        return not (by_chance or self._samples_track or self._variants > 1)

    def __call__(self, streams: RandomStreams, wanted: Tensor) -> CarState:
        """Starts for the `wanted` cars, [N] bool with K of them true, drawn from their own streams: [K]."""
        start, everyone = self._start, len(wanted)
        place = streams.uniform(wanted=wanted) if start.anywhere else torch.zeros(everyone).double()
        track = self._draw_tracks(streams, wanted)
        return self._simulator.start(
            stations=(place * self._simulator.routes.lengths[track])[wanted],
            track=track[wanted],
            offset=_draw_within(start.offset, streams, wanted),
            heading=_draw_within(math.radians(start.heading_jitter), streams, wanted),
            speed=self._draw_speeds(streams, wanted),
        )

    def _draw_speeds(self, streams: RandomStreams, wanted: Tensor) -> Tensor | None:
        """Speeds at the start, [K], m/s; None for cars at rest."""
        start = self._start
        if not (start.speed or start.speed_spread):
            return None
        spread = _draw_within(start.speed_spread, streams, wanted)
        speed = torch.full((int(wanted.sum()),), float(start.speed), dtype=torch.float64)
        return speed if spread is None else (speed + spread).clamp(min=0)

    def _draw_tracks(self, streams: RandomStreams, wanted: Tensor) -> Tensor:
        """Which track each car drives on, [N]."""
        base = (streams.uniform(wanted=wanted) * self._bases).long() if self._samples_track else self._own_base
        if self._variants == 1:
            return base
        return base * self._variants + (streams.uniform(wanted=wanted) * self._variants).long()


def _draw_within(most: float, streams: RandomStreams, wanted: Tensor) -> Tensor | None:
    """Numbers between -most and most, [K]."""
    return most * (2 * streams.uniform(wanted=wanted)[wanted] - 1) if most else None


@dataclass
class EpisodeState(Rows):
    """All that moves in an episode.

    Attributes:
        cars: of the simulator.
        step: steps since the start, [N], int64.
        last_action: of the step before; `ActionMap.first` at the start, [N] or [N, C].
        seen: the observation, [N, O], float32; None where no term looks back at it.
        stalled: for how many steps the car has made no progress, [N], int64; None where that does not matter.
        contact: the body touched a wall in the last step, [N], bool; None where nobody has kept it.
    """

    cars: CarState
    step: Tensor
    last_action: Tensor
    seen: Tensor | None = None
    stalled: Tensor | None = None
    contact: Tensor | None = None


@dataclass
class ObservationContext:
    """What an observation is made of.

    Attributes:
        state: of the episodes.
        ranges: true distance to the wall along each ray, [N, R], m.
        simulator: what moves the cars.
        action: what the agent chooses among.
        streams: random numbers of all cars.
        wanted: which cars of the streams these N are, bool; None for all.
        place: where on the road the cars are; None unless a term needs it.
        seen: what the term that is asked told one step before, [N, width]; None at a start, or unless it needs that.
        on_car: whether each ray ends at a car, [N, R], bool; None where each car is alone.
    """

    state: EpisodeState
    ranges: Tensor
    simulator: Simulator
    action: ActionMap
    streams: RandomStreams
    wanted: Tensor | None = None
    place: Place | None = None
    seen: Tensor | None = None
    on_car: Tensor | None = None

    def value(self, name: str) -> Tensor:
        """One entry of the vehicles' states by its name, [N].

        Raises:
            ConfigError: the vehicle's state has none of this name.
        """
        return _value(self.state.cars, self.simulator.vehicle, name)


@dataclass
class StepContext:
    """What a reward is made of.

    Attributes:
        before: the step.
        taken: the action of the step, [N] or [N, C].
        outcome: of the simulator.
        simulator: what moved the cars.
        action: what the agent chose among.
    """

    before: EpisodeState
    taken: Tensor
    outcome: Outcome
    simulator: Simulator
    action: ActionMap

    @cached_property
    def readings(self) -> Tensor:
        """True distance along each ray after the step / range, [N, R], in 0..1, whatever the sensor reads."""
        return self.simulator.sensor.readings(self.outcome.ranges)

    def control(self, name: str) -> Tensor:
        """One control of the step by its name, [N], in [-1, 1].

        Raises:
            ConfigError: the vehicle has none of this name.
        """
        return self._controls[:, self._index(name)]

    def last_control(self, name: str) -> Tensor:
        """The same of the step before."""
        return self.action.controls(self.before.last_action)[:, self._index(name)]

    def value(self, name: str) -> Tensor:
        """One entry of the vehicles' states after the step by its name, [N].

        Raises:
            ConfigError: the vehicle's state has none of this name.
        """
        return _value(self.outcome.cars, self.simulator.vehicle, name)

    def value_before(self, name: str) -> Tensor:
        """The same before the step."""
        return _value(self.before.cars, self.simulator.vehicle, name)

    @cached_property
    def _controls(self) -> Tensor:
        return self.action.controls(self.taken)

    def _index(self, name: str) -> int:
        names = self.simulator.vehicle.control_names
        if name not in names:
            raise ConfigError(f"a term wants the control {name!r}; the vehicle has {', '.join(names)}")
        return names.index(name)


def _value(cars: CarState, vehicle: VehicleModel, name: str) -> Tensor:
    if name not in vehicle.state_names:
        raise ConfigError(
            f"a term wants the {name} of the car; the state of the vehicle {type(vehicle).__name__} has "
            f"{', '.join(vehicle.state_names)}"
        )
    return cars.state[:, vehicle.state_names.index(name)]
