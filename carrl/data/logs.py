"""Logs of earlier runs as what there is to learn from.

Shapes: `T` transitions, `A` agents, which all learn from the same ones.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from carrl.data.replay_buffer import KEYS
from carrl.errors import LogError
from carrl.log import Log, fill
from carrl.sim.sensor import Sensor
from carrl.task.action import ActionMap
from carrl.task.world import World

Numbers = NDArray[np.float64]


def check_logs(paths: Sequence[Path], world: World) -> int:
    """How many transitions the logs hold in all, each seen as a car with these sensors would.

    Only the logs' indices, metadata and ends are read.

    Args:
        paths: of the logs.
        world: whose observations the network is to understand, and whose actions it chooses among.

    Raises:
        LogError: a log is missing or damaged, or was written by a car with other sensors or actions.
    """
    total = 0
    for path in paths:
        with Log(path) as log:
            if log.transitions:
                _check_width(log, world)
            _check_sensor(log, world.sensor)
            _check_actions(log, world)
            total += log.transitions
    return total


def fill_from_logs(buffer: TensorDictReplayBuffer, paths: Sequence[Path], agents: int, action: ActionMap) -> None:
    """Puts every transition of the logs into the memories of all agents, a message at a time.

    Raises:
        LogError: a log is damaged, or has an action that there is not.
    """
    for path in paths:
        memories: Any = _Memories(buffer, agents, path, action)
        fill(memories, path)


class _Memories:
    """The way of a log's transitions into a buffer."""

    def __init__(self, buffer: TensorDictReplayBuffer, agents: int, path: Path, action: ActionMap) -> None:
        self._buffer, self._agents, self._path = buffer, agents, path
        self._spec, self._names = action.spec, action.names

    def extend(self, transitions: TensorDictBase) -> None:
        """Stores transitions [T] once for each agent, [T, A]."""
        action = transitions["action"]
        if not self._spec.expand(action.shape).is_in(action):
            raise LogError(
                f"log '{self._path}': has actions {action.min()}..{action.max()}; "
                f"they must lie in 0..{len(self._names) - 1}, {', '.join(self._names)}"
            )
        self._buffer.extend(transitions.select(*KEYS)[:, None].expand(len(transitions), self._agents))


def _check_width(log: Log, world: World) -> None:
    found = log.schema.by_name["observation"].width
    if found != world.observation_size:
        parts = world.observation.parts(world.sensor, world.action)
        raise LogError(
            f"log '{log.path}': its observations have {found} values, the network reads {world.observation_size} "
            f"({', '.join(f'{part.width} of {part.name}' for part in parts)}); "
            "set sensor.rays and observation as in the run that wrote it"
        )


def _check_sensor(log: Log, sensor: Sensor) -> None:
    reach = _numbers(log, "sensor_range_m", sensor.max_range)
    if not _alike(reach, sensor.max_range):
        raise LogError(
            f"log '{log.path}': its sensor reaches {reach} m, this configuration's {sensor.max_range} m; "
            f"set sensor.max_range={reach}"
        )
    angles = sensor.angles.numpy()
    found = _numbers(log, "sensor_angles_rad", angles)
    if not _alike(found, angles):
        raise LogError(
            f"log '{log.path}': its sensor has {_fan(found)}, this configuration's {_fan(angles)}; "
            "set sensor.rays and sensor.field_of_view as in the run that wrote it"
        )


def _check_actions(log: Log, world: World) -> None:
    own = list(world.action.names)
    names = _entry(log, "action_names", own)
    if names != own:
        raise LogError(
            f"log '{log.path}': its actions are {names!r:.100}, this car's are {own}; "
            "give the log of a car with the same"
        )


def _numbers(log: Log, key: str, default: Any) -> Numbers:
    try:
        return np.asarray(_entry(log, key, default), dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise LogError(f"log '{log.path}': its metadata entry '{key}' holds no numbers; give an intact log") from error


def _entry(log: Log, key: str, default: Any) -> Any:
    """What the log's metadata says under a key; the default where it says nothing."""
    try:
        return json.loads(log.metadata[key]) if key in log.metadata else default
    except (ValueError, RecursionError) as error:
        raise LogError(f"log '{log.path}': its metadata entry '{key}' is not JSON; give an intact log") from error


def _alike(found: Numbers, wanted: Any) -> bool:
    """Whether these are the same numbers up to rounding."""
    return found.shape == np.shape(wanted) and bool(np.allclose(found, wanted, rtol=1e-5, atol=1e-6))


def _fan(angles: Numbers) -> str:
    return f"{angles.size} rays over {math.degrees(np.ptp(angles)):.0f} degrees" if angles.size else "no rays"
