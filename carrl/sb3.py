"""The driving task for Stable-Baselines3, which is imported when an environment is made."""

from typing import TYPE_CHECKING, Any

from carrl.errors import ConfigError

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
    from carrl.env.sb3_vec_env import TrackVecEnv

    return VecMonitor(TrackVecEnv(track, num_envs, seed=seed, **options))
