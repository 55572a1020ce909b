"""The driving task for PettingZoo: the cars of one world, each of them an agent, NumPy in and NumPy out."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from carrl.env.gym_env import ActionError, action_space, check_options, observation_space, one_action
from carrl.errors import ConfigError
from carrl.sim.simulator import CarState
from carrl.task.checks import seed_number
from carrl.task.task import UNLIMITED, EpisodeStart, Tracks, make_task

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ConfigError(
        "carrl.parallel_env needs PettingZoo, which is not installed; pip install 'carrl[pettingzoo]'"
    ) from error

if TYPE_CHECKING:
    from gymnasium import Space

Values = dict[str, Any]


class ParallelTrackEnv(ParallelEnv):
    """The cars of one world, `car_0` and so on; see `carrl.parallel_env`.

    A car whose episode has ended leaves the road until `reset`. Where there are opponents, there is one agent.

    Attributes:
        task: what they do.
    """

    metadata = {"name": "carrl_track_v0", "render_modes": []}  # noqa: RUF012 (PettingZoo's way)
    render_mode = None

    def __init__(self, track: Tracks, cars: int, max_steps: int, **options: Any) -> None:
        """Builds the simulator."""
        check_options(options, ("cars", "max_steps"))
        count = 1 if options.get("opponents") is not None else cars
        self.task = make_task(track, count, cars_per_world=cars, max_steps=max_steps, **options)
        self.possible_agents = [f"car_{number}" for number in range(count)]
        self.agents: list[str] = []
        self._spaces = observation_space(self.task), action_space(self.task.action)
        self._now: EpisodeStart | None = None

    def observation_space(self, agent: str) -> "Space[Any]":
        """The same of all."""
        return self._spaces[0]

    def action_space(self, agent: str) -> "Space[Any]":
        """The same of all."""
        return self._spaces[1]

    def reset(self, seed: int | None = None, options: Values | None = None) -> tuple[Values, Values]:
        """All cars at the start.

        Raises:
            ConfigError: the seed is no whole number, or below 0 or above 2^63 - 1.
        """
        if seed is not None:
            self.task.streams.seed(seed_number(seed))
        self._now, self.agents = self.task.start(), list(self.possible_agents)
        return self._by_agent(self._now.observation.numpy().copy()), {agent: {} for agent in self.agents}

    def step(self, actions: Values) -> tuple[Values, Values, Values, Values, Values]:
        """One step of all cars that are on the road.

        Raises:
            ConfigError: there was no reset.
            ActionError: a car's action is missing, or is none.
        """
        if self._now is None:
            raise ConfigError("call reset before the first step")
        taken = self._now.state.last_action.clone()
        for agent in self.agents:
            if agent not in actions:
                raise ActionError(f"actions has none of {agent}; each car on the road needs one")
            taken[self.possible_agents.index(agent)] = one_action(actions[agent], self.task.action)[0]
        after = self.task.step(self._now.state, taken)
        views, terms = after.observation.numpy().copy(), after.reward_terms.numpy()
        ends, cuts = after.terminated.numpy(), after.truncated.numpy()
        outcome = (
            self._by_agent(views),
            {agent: float(value) for agent, value in self._by_agent(terms.sum(axis=1)).items()},
            {agent: bool(value) for agent, value in self._by_agent(ends).items()},
            {agent: bool(value) for agent, value in self._by_agent(cuts).items()},
            {
                agent: dict(zip(self.task.reward.term_names, map(float, value), strict=True))
                for agent, value in self._by_agent(terms).items()
            },
        )
        gone = ends | cuts
        state = replace(after.state, cars=_taken_away(after.state.cars, torch.from_numpy(gone)))
        self._now = EpisodeStart(state, after.observation)
        self.agents = [agent for agent, left in self._by_agent(gone).items() if not left]
        return outcome

    def _by_agent(self, values: np.ndarray) -> Values:
        """Those of the cars that are on the road."""
        return {agent: values[self.possible_agents.index(agent)] for agent in self.agents}


def parallel_env(
    track: Tracks = "paper", cars: int = 2, *, max_steps: int = UNLIMITED, **options: Any
) -> ParallelTrackEnv:
    """The cars of one world as PettingZoo's agents.

    Args:
        track: a track, or what `Track.load` takes.
        cars: how many share the world, those that opponents drive included.
        max_steps: length at which an episode is truncated, steps.
        options: those of `TrackEnv`, from `vehicle` on.

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter is of another type or out of its range.
    """
    return ParallelTrackEnv(track, cars, max_steps, **options)


def _taken_away(cars: CarState, gone: torch.Tensor) -> CarState:
    """The cars, of which those that are gone are nowhere: nobody sees or touches them."""
    nowhere = torch.where(gone[:, None], torch.nan, cars.state)
    return replace(cars, state=nowhere)
