"""The driving task for Stable-Baselines3, which is imported when an environment is made."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv

from carrl.env.gym_env import action_space, observation_space
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError
from carrl.task.task import Tracks

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecMonitor

    from carrl.task.task import Tracks


def make_vec_env(
    track: "Tracks" = "paper", num_envs: int = 1, *, seed: int | None = None, **options: Any
) -> "VecMonitor":
    """Makes N cars in one simulator, for `PPO("MlpPolicy", carrl.sb3.make_vec_env(num_envs=64))` and the like.

    They are driven many times faster than by as many copies of `carrl/Track-v0`, and start and end their episodes as
    `TrackEnv`'s do. Stable-Baselines3's monitor is about them, for the lengths and returns of episodes that it logs.

    Args:
        track: a track, or what `Track.load` takes; or a list of such, of which car i drives on number i modulo their
            number.
        num_envs: how many cars, N.
        seed: of random starts and the like; a model's own `seed` takes its place. None for a fresh one.
        options: those of `TrackEnv`, from `vehicle` on.

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter is of another type or out of its range, or Stable-Baselines3 is not installed.
    """
    try:
        from stable_baselines3.common.vec_env import VecMonitor
    except ImportError as error:
        raise ConfigError(
            "carrl.sb3 needs Stable-Baselines3, which is not installed; pip install 'carrl[sb3]'"
        ) from error
    from carrl.sb3 import TrackVecEnv

    return VecMonitor(TrackVecEnv(track, num_envs, seed=seed, **options))


class TrackVecEnv(VecEnv):
    """`TrackEnv` with N cars behind Stable-Baselines3's interface; see `carrl.sb3.make_vec_env`.

    Observations are [N, R], float32, in [0, 1], actions [N], int64, unless `observation` and `action` say otherwise;
    rewards [N], float32.
    """

    def __init__(self, track: Tracks, num_envs: int, *, seed: int | None = None, **options: Any) -> None:
        """Puts all cars at the start."""
        self._env = TrackEnv(track, num_envs, seed=seed, **options)
        task = self._env.task
        super().__init__(task.cars, observation_space(task), action_space(task.action))
        self._now = self._env.reset()

    def reset(self) -> np.ndarray:
        """Observations [N, R] of all cars at the start; the seed that `seed` was called with counts from here on."""
        if self._seeds[0] is not None:
            self._env.set_seed(self._seeds[0])
        self._reset_seeds()
        self._now = self._env.reset()
        return self._now["observation"].numpy()

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions [N]; `step_wait` drives."""
        self._now["action"] = torch.as_tensor(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Drives one step; a car whose episode ended is back at the start, with its last view in `infos`.

        Raises:
            ConfigError: an action is none; see `TrackEnv`.
        """
        driven, self._now = self._env.step_and_maybe_reset(self._now)
        after = driven["next"]
        done, truncated = after["done"].view(-1).numpy(), after["truncated"].view(-1).numpy()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for car in done.nonzero()[0]:
            last_view = after["observation"][car].numpy()
            infos[car] = {"terminal_observation": last_view, "TimeLimit.truncated": bool(truncated[car])}
        return self._now["observation"].numpy(), after["reward"].view(-1).numpy(), done, infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The same attribute of `TrackEnv` for every car asked for."""
        value = None if attr_name == "render_mode" else getattr(self._env, attr_name)
        return [value for _ in self._cars(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the cars share one environment."""
        raise NotImplementedError("the cars share one environment; build another one instead")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: the cars share one environment."""
        raise NotImplementedError("the cars share one environment; call TrackEnv's method instead")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No car has a wrapper."""
        return [False for _ in self._cars(indices)]

    def _cars(self, indices: int | Sequence[int] | None) -> Sequence[int]:
        return list(self._get_indices(indices))
