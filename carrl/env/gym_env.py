"""The driving task for Gymnasium: one car, NumPy in and NumPy out.

Shapes: `R` rays.
"""

from typing import Any

import gymnasium
import numpy as np
import torch

from carrl.env.reward import TERMS
from carrl.env.task import Situation, Task, Tracks
from carrl.errors import ConfigError
from carrl.sim.vehicle import Action


class GymTrackEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One car on a track: `gymnasium.make("carrl/Track-v0", track=...)` after `import carrl`.

    The same task as `TrackEnv` with one car. `gymnasium.make` truncates at 1,000 steps (its `max_episode_steps`).

    Observations are distances along each ray / range, [R], float32, in [0, 1], right to left. Actions are
    0 forward, 1 left, 2 right. `info` holds `pose` (x m, y m, heading rad), `gates_passed`, `track` (the name of the one
    it drives on), and after a step the reward's terms by name.

    Args:
        track: a track, or what `Track.load` takes, or a list of such.
        render_mode: None; this environment does not draw.
        options: those of `TrackEnv`, from `vehicle` on, but for `max_steps`.

    Raises:
        TrackError: the track cannot be loaded.
        ConfigError: a parameter is out of its range.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own convention)

    def __init__(self, track: Tracks = "paper", *, render_mode: str | None = None, **options: Any) -> None:
        """Builds the simulator and declares the spaces."""
        if render_mode is not None:
            raise ConfigError(f"render_mode is {render_mode!r}; this environment does not draw, so leave it out")
        self.task = Task(track, max_steps=NEVER, **options)
        self.render_mode = None
        self.observation_space = gymnasium.spaces.Box(0.0, 1.0, (self.task.observation_size,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(len(Action))
        self._now: Situation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Puts the car at the start."""
        super().reset(seed=seed)
        if seed is not None:
            self.task.streams.seed(seed)
        self._now = self.task.start()
        return self._now.observation[0].numpy(), self._info(self._now)

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drives one time step; terminates on a collision and never truncates by itself."""
        if self._now is None:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        after = self.task.step(self._now, torch.tensor([int(action)]))
        self._now = after.situation
        terms = after.reward_terms[0]
        info = self._info(self._now) | dict(zip(TERMS, terms.tolist(), strict=True))
        return self._now.observation[0].numpy(), terms.sum().item(), after.terminated.item(), False, info

    def _info(self, now: Situation) -> dict[str, Any]:
        pose, _, gates_passed, track = now.state
        name = self.task.simulator.tracks[track.item()].name
        return {"pose": pose[0].numpy(), "gates_passed": gates_passed.item(), "track": name}


NEVER = 2**62
"""As `max_steps`: Gymnasium's own time limit truncates."""
