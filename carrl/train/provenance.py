"""What a log says of the run that wrote it: the world, the packages, the commit."""

import json
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import torch

import carrl
from carrl.env.track_env import TrackEnv
from carrl.log.scene import Scene
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import ActionMap

PACKAGES = ("torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "mcap", "protobuf", "numpy", "numba")
_GIT_TIMEOUT_S = 5.0


def describe_run(env: TrackEnv, seed: int, cars: int) -> dict[str, str]:
    """The entries of a log's metadata for the agent with this seed, who drives so many cars."""
    entries = {
        "seed": str(seed),
        "track": env.track.name if len(env.tracks) == 1 else f"{len(env.tracks)} tracks",
        "num_envs": str(cars),
        "packages": json.dumps({"carrl": carrl.__version__, **_versions()}),
        **scene_of(env).entries(),
    }
    commit = git_commit()
    return entries | ({"git_commit": commit} if commit else {})


def scene_of(env: TrackEnv) -> Scene:
    """The world of an environment, without its tracks, which a log has as attachments."""
    vehicle, action = env.simulator.vehicle, env.task.action
    return Scene(
        action_names=tuple(action.names),
        reward_terms=env.task.reward.term_names,
        sensor_angles=env.sensor_angles.double().cpu().numpy(),
        sensor_range=env.sensor_range,
        time_step=vehicle.time_step,
        body_radius=vehicle.body_radius,
        manoeuvres=_manoeuvres(vehicle, action),
        tracks=(),
    )


def _manoeuvres(vehicle: VehicleModel, action: ActionMap) -> np.ndarray:
    """Where a step of each action leads: distance m, its bearing rad, change of heading rad, [A, 3]."""
    start = torch.zeros(action.spec.n, len(vehicle.state_names), dtype=torch.float64)
    x, y, yaw = vehicle.step(start, action.controls(torch.arange(len(start)))).double().numpy()[:, :3].T
    return np.stack([np.hypot(x, y), np.arctan2(y, x), yaw], axis=-1)


def git_commit() -> str | None:
    """The commit of the checkout that this code runs from, with "-dirty" after it where files differ; None if none."""
    root = Path(carrl.__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _versions() -> dict[str, str]:
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
