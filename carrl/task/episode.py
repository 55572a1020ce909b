"""What the terms of a task are functions of: an episode at one moment, and one step from a moment to the next.

Shapes: `N` cars, `S` entries of a vehicle's state, `C` controls, `R` rays.
"""

from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from carrl.errors import ConfigError
from carrl.rows import Rows
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.task.action import ActionMap
from carrl.task.random_streams import RandomStreams


@dataclass(frozen=True)
class EpisodeState(Rows):
    """All that moves in an episode.

    Attributes:
        cars: of the simulator.
        step: steps since the start, [N], int64.
        last_action: of the step before; `ActionMap.first` at the start, [N] or [N, C].
    """

    cars: CarState
    step: Tensor
    last_action: Tensor


@dataclass(frozen=True)
class Moment:
    """What an observation is made of.

    Attributes:
        state: of the episodes.
        ranges: true distance to the wall along each ray, [N, R], m.
        simulator: what moves the cars.
        action: what the agent chooses among.
        streams: random numbers of all cars.
        wanted: which cars of the streams these N are, bool; None for all.
    """

    state: EpisodeState
    ranges: Tensor
    simulator: Simulator
    action: ActionMap
    streams: RandomStreams
    wanted: Tensor | None = None


@dataclass(frozen=True)
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

    @cached_property
    def _controls(self) -> Tensor:
        return self.action.controls(self.taken)

    def _index(self, name: str) -> int:
        names = self.simulator.vehicle.control_names
        if name not in names:
            raise ConfigError(f"a term wants the control {name!r}; the vehicle has {', '.join(names)}")
        return names.index(name)
