"""CarRL trains a car to drive from a handful of distance sensors.

    run = carrl.train("fast", seed=3)                       a Run: what `carrl train experiment=fast seed=3` trains
    run.evaluate("oval"), run.policy, run.log               drive it elsewhere, take its policy, read its log
    carrl.Run.load("outputs/2026-01-31/12-00-00")           a run of before
    carrl.log.load("train.mcap")                            a log's transitions, a TensorDict
    carrl.TrackEnv(track="paper", num_envs=64, seed=0)      the driving task as a TorchRL environment
    gymnasium.make("carrl/Track-v0", track="oval")          the same for Gymnasium, and make_vec for many cars
    carrl.sb3.make_vec_env(...)                             the same for Stable-Baselines3
    carrl.GroupTrackEnv(...), carrl.parallel_env(...)       cars that share a world, for TorchRL's agents and PettingZoo
    carrl.Track.load("oval"), carrl.Track.random(seed=7)    roads: built in, files, made up

What a world is made of: Vehicle, Bicycle, Sensor, DiscreteActions, ContinuousActions, Observation, Reward, Start. Every
error that a user can mend is a CarrlError. help(carrl.TrackEnv) and the like tell more, and so do README.md and docs/.
"""

import importlib
import time
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from carrl.registration import register_with_gymnasium, register_with_torchrl

_IMPORTED_AT = time.monotonic()

if TYPE_CHECKING:
    from carrl import log, sb3, train
    from carrl.env.group_env import GroupTrackEnv
    from carrl.env.gym_env import GymTrackEnv
    from carrl.env.gym_vector_env import GymVectorTrackEnv
    from carrl.env.parallel_env import parallel_env
    from carrl.env.track_env import TrackEnv
    from carrl.errors import CarrlError
    from carrl.export.policy.loaded import load_policy
    from carrl.sim.sensor import Sensor
    from carrl.sim.vehicle import Bicycle, Vehicle, VehicleModel
    from carrl.task.action import ContinuousActions, DiscreteActions
    from carrl.task.episode import Start
    from carrl.task.observation import Observation, rays_and_last_action
    from carrl.task.reward import Reward, paper_reward
    from carrl.tracks.track import Track
    from carrl.train.run import Run

__all__ = [
    "Bicycle",
    "CarrlError",
    "ContinuousActions",
    "DiscreteActions",
    "GroupTrackEnv",
    "GymTrackEnv",
    "GymVectorTrackEnv",
    "Observation",
    "Reward",
    "Run",
    "Sensor",
    "Start",
    "Track",
    "TrackEnv",
    "Vehicle",
    "VehicleModel",
    "__version__",
    "load_policy",
    "log",
    "paper_reward",
    "parallel_env",
    "rays_and_last_action",
    "sb3",
    "train",
]

try:
    __version__ = version("carrl")
except PackageNotFoundError:  # a checkout on the path that was never installed
    __version__ = "0+unknown"

register_with_gymnasium()
register_with_torchrl()

_HOMES = {
    "Bicycle": "carrl.sim.vehicle",
    "CarrlError": "carrl.errors",
    "ContinuousActions": "carrl.task.action",
    "DiscreteActions": "carrl.task.action",
    "GroupTrackEnv": "carrl.env.group_env",
    "GymTrackEnv": "carrl.env.gym_env",
    "GymVectorTrackEnv": "carrl.env.gym_vector_env",
    "Observation": "carrl.task.observation",
    "Reward": "carrl.task.reward",
    "Run": "carrl.train.run",
    "Sensor": "carrl.sim.sensor",
    "Start": "carrl.task.episode",
    "Track": "carrl.tracks.track",
    "TrackEnv": "carrl.env.track_env",
    "Vehicle": "carrl.sim.vehicle",
    "VehicleModel": "carrl.sim.vehicle",
    "load_policy": "carrl.export.policy.loaded",
    "paper_reward": "carrl.task.reward",
    "parallel_env": "carrl.env.parallel_env",
    "rays_and_last_action": "carrl.task.observation",
}


def __dir__() -> list[str]:
    """The public names, whether imported yet or not, and Python's own."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    """Imports a public name on first use, so that `carrl log` starts without waiting for torch."""
    if name in ("log", "sb3", "train"):
        return importlib.import_module(f"carrl.{name}")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'carrl' has no attribute {name!r}")
