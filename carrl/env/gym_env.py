"""The driving task for Gymnasium: one car, NumPy in and NumPy out.

Shapes: `R` rays.
"""

from typing import Any

import gymnasium
import numpy as np
import torch

from carrl.env.observation import FIRST_ACTION
from carrl.env.reward import TERMS, Reward
from carrl.errors import ConfigError
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator, State
from carrl.sim.track import Track
from carrl.sim.vehicle import Action, Vehicle


class GymTrackEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One car on a track: `gymnasium.make("carrl/Track-v0", track=...)` after `import carrl`.

    The same task as `TrackEnv` with one car. `gymnasium.make` truncates at 1,000 steps (its `max_episode_steps`).

    Observations are distances along each ray / range, [R], float32, in [0, 1], right to left. Actions are
    0 forward, 1 left, 2 right. `info` holds `pose` (x m, y m, heading rad), `gates_passed`, and after a step the
    reward's terms by name.

    Args:
        track: a track, or what `Track.load` takes.
        vehicle: the car.
        sensor: its rays.
        reward: what a step earns.
        random_start: start anywhere along the centreline instead of on the start line.
        render_mode: None; this environment does not draw.

    Raises:
        TrackError: the track cannot be loaded.
        ConfigError: a parameter is out of its range.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own convention)

    def __init__(
        self,
        track: Track | str = "paper",
        *,
        vehicle: Vehicle | None = None,
        sensor: Sensor | None = None,
        reward: Reward | None = None,
        random_start: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """Builds the simulator and declares the spaces."""
        if render_mode is not None:
            raise ConfigError(f"render_mode is {render_mode!r}; this environment does not draw, so leave it out")
        track = track if isinstance(track, Track) else Track.load(track)
        self.simulator = Simulator(track, vehicle or Vehicle(), sensor or Sensor())
        self.reward = reward or Reward()
        self.random_start = random_start
        self.render_mode = None
        self.observation_space = gymnasium.spaces.Box(0.0, 1.0, (self.simulator.sensor.rays,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(len(Action))
        self._state: State | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Puts the car at the start."""
        super().reset(seed=seed)
        station = self.np_random.uniform(0, self.simulator.track.length) if self.random_start else 0.0
        self._state = self.simulator.start(torch.tensor([station], dtype=torch.float64))
        self._last_action = torch.tensor([int(FIRST_ACTION)])
        observation = self.simulator.sense(self._state.pose) / self.simulator.sensor.max_range
        return observation[0].numpy(), self._info(self._state)

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drives one time step; terminates on a collision and never truncates by itself."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        taken = torch.tensor([int(action)])
        outcome = self.simulator.step(self._state, taken)
        self._state = outcome.state
        observation = outcome.ranges / self.simulator.sensor.max_range
        terms = self.reward.terms(observation, outcome.collided, outcome.gates_passed, taken, self._last_action)[0]
        self._last_action = taken
        info = self._info(outcome.state) | dict(zip(TERMS, terms.tolist(), strict=True))
        return observation[0].numpy(), terms.sum().item(), bool(outcome.collided), False, info

    @staticmethod
    def _info(state: State) -> dict[str, Any]:
        return {"pose": state.pose[0].numpy(), "gates_passed": state.gates_passed.item()}
