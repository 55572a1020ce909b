"""CarRL trains a car to drive from a handful of distance sensors."""

import importlib
import time
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

_IMPORTED_AT = time.monotonic()

import gymnasium  # noqa: E402 (takes long enough to count as start-up)

if TYPE_CHECKING:
    from carrl import log
    from carrl.env.gym_env import GymTrackEnv
    from carrl.env.gym_vector_env import GymVectorTrackEnv
    from carrl.env.reward import Reward
    from carrl.env.track_env import TrackEnv
    from carrl.sim.sensor import Sensor
    from carrl.sim.track import Track
    from carrl.sim.vehicle import Action, Bicycle, Vehicle

__all__ = [
    "Action",
    "Bicycle",
    "GymTrackEnv",
    "GymVectorTrackEnv",
    "Reward",
    "Sensor",
    "Track",
    "TrackEnv",
    "Vehicle",
    "__version__",
    "log",
]

try:
    __version__ = version("carrl")
except PackageNotFoundError:  # a checkout on the path that was never installed
    __version__ = "0+unknown"

gymnasium.register(
    "carrl/Track-v0",
    entry_point="carrl.env.gym_env:GymTrackEnv",
    vector_entry_point="carrl.env.gym_vector_env:GymVectorTrackEnv",
    max_episode_steps=1000,
)

_HOMES = {
    "Action": "carrl.sim.vehicle",
    "Bicycle": "carrl.sim.vehicle",
    "GymTrackEnv": "carrl.env.gym_env",
    "GymVectorTrackEnv": "carrl.env.gym_vector_env",
    "Reward": "carrl.env.reward",
    "Sensor": "carrl.sim.sensor",
    "Track": "carrl.sim.track",
    "TrackEnv": "carrl.env.track_env",
    "Vehicle": "carrl.sim.vehicle",
}


def __getattr__(name: str) -> Any:
    """Imports a public name on first use, so that `carrl log` starts without waiting for torch."""
    if name == "log":
        return importlib.import_module("carrl.log")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'carrl' has no attribute {name!r}")
