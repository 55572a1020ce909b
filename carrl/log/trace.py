"""One episode of a log, ready to be looked at: what the car saw, chose and got, step by step.

Shapes: `T` steps, `R` rays, `A` actions, `K` terms of the reward.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carrl.errors import DamagedLogError, LogError
from carrl.log.metadata import ATTACHMENT
from carrl.log.reader import Log
from carrl.log.scene import Floats, Scene, TrackShape
from carrl.log.selection import Selection

_GREATEST = 1e30
"""Of a reading, which should be 1 at most: single precision must hold where its ray ends."""
_TRACK_NAME = re.compile(r"track(?:-(\d{1,6}))?\.json")


@dataclass(frozen=True, eq=False)
class EpisodeTrace:
    """The recorded steps of one episode, at least one.

    Attributes:
        scene: sensors, car and tracks.
        columns: of the log, by name, each [T, ...], in the order of the steps.
    """

    scene: Scene
    columns: Mapping[str, NDArray[np.generic]]

    def __len__(self) -> int:
        """Steps, T."""
        return len(self.columns["action"])

    @property
    def episode(self) -> int:
        """Number of the episode within the run."""
        return int(self.columns["episode"][0])

    @property
    def env(self) -> int:
        """Index of the car among those simulated side by side."""
        return int(self.columns["env"][0])

    @property
    def track(self) -> TrackShape:
        """Where it was driven."""
        return self.scene.tracks[int(self.columns["track"][0])]

    @property
    def ended(self) -> Literal["collision", "time limit", "unfinished"]:
        """Why the record ends."""
        if self.columns["terminated"][-1].any():
            return "collision"
        return "time limit" if self.columns["truncated"][-1].any() else "unfinished"

    @property
    def first_step(self) -> int:
        """Index of the first recorded step within the episode; 0 unless the log lacks the episode's beginning."""
        return int(self.columns["step"][0])

    @property
    def actions(self) -> NDArray[np.int64]:
        """Of each step, indices into `scene.action_names`, [T]."""
        return np.asarray(self.columns["action"], dtype=np.int64)

    @property
    def rewards(self) -> Floats:
        """Of each step, [T]."""
        return np.asarray(self.columns["reward"], dtype=np.float64)[:, 0]

    @property
    def reward_terms(self) -> Floats:
        """The reward of each step, split into `scene.reward_terms`, [T, K]."""
        return np.asarray(self.columns["reward_terms"], dtype=np.float64)

    @property
    def action_values(self) -> Floats:
        """Q-values from which each step's action was chosen, [T, A]."""
        return np.asarray(self.columns["action_value"], dtype=np.float64)

    @property
    def exploratory(self) -> NDArray[np.bool_]:
        """Whether each step's action was drawn at random, [T]."""
        return np.asarray(self.columns["exploratory"], dtype=np.bool_)

    @property
    def epsilon(self) -> Floats:
        """Probability of a random action at each step, [T]."""
        return np.asarray(self.columns["epsilon"], dtype=np.float64)

    @cached_property
    def times(self) -> Floats:
        """Simulated time since the start of the run, before each step and after the last, [T + 1], s."""
        begin = np.asarray(self.columns["time_ns"], dtype=np.int64) / 1e9
        return np.append(begin, begin[-1] + self.scene.time_step)

    @cached_property
    def poses(self) -> Floats:
        """Where the car was, x m, y m, heading rad, before each step and after the last, [T + 1, 3].

        The log has the poses before the steps; the last one follows from the last action.
        """
        recorded = np.asarray(self.columns["pose"], dtype=np.float64)
        x, y, heading = recorded[-1]
        distance, bearing, yaw = self.scene.manoeuvres[self.actions[-1]]
        direction = heading + bearing
        last = [x + distance * np.cos(direction), y + distance * np.sin(direction), heading + yaw]
        return np.vstack([recorded, last])

    @cached_property
    def ranges(self) -> Floats:
        """What each ray read before each step and after the last, [T + 1, R], m."""
        rays = len(self.scene.sensor_angles)
        seen = [self.columns["observation"][:, :rays], self.columns["next_observation"][-1:, :rays]]
        readings = np.vstack(seen).astype(np.float64)
        return np.where(np.isfinite(readings), readings.clip(-_GREATEST, _GREATEST), readings) * self.scene.sensor_range

    @cached_property
    def gates_passed(self) -> NDArray[np.int64]:
        """How many gates were passed up to before each step and after the last, [T + 1], as the gate rewards tell."""
        if "gate" not in self.scene.reward_terms:
            return np.zeros(len(self) + 1, dtype=np.int64)
        return np.append(0, (self.reward_terms[:, self.scene.reward_terms.index("gate")] > 0).cumsum())

    def ray_ends(self) -> Floats:
        """Where the rays end, before each step and after the last, [T + 1, R, 2], m."""
        angles = self.poses[:, 2:] + self.scene.sensor_angles
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return np.asarray(self.poses[:, None, :2] + self.ranges[:, :, None] * directions)


def read_scene(log: Log) -> Scene:
    """The world that a log was recorded in.

    Raises:
        DamagedLogError: the log's metadata or attachments do not describe one.
    """
    own = [name for name in log.attachments if ATTACHMENT + name in log.metadata]
    numbers = {name: int(match[1] or 0) for name in own if (match := _TRACK_NAME.fullmatch(name))}
    try:
        tracks = [TrackShape.from_json(log.attachment(name)) for name in sorted(numbers, key=numbers.__getitem__)]
        return Scene.from_entries(log.metadata, tracks)
    except ValueError as error:
        raise _undescribed(log, str(error)) from error


def read_trace(log: Log, episode: int) -> EpisodeTrace:
    """One episode of a log.

    Raises:
        LogError: the log holds no transition of it.
        DamagedLogError: it is not an intact log.
    """
    scene = read_scene(log)
    columns = log.columns(Selection(episodes=[episode]))
    if not len(columns["action"]):
        raise LogError(f"log '{log.path}': holds no step of episode {episode}; carrl log ls FILE shows which it has")
    _check_widths(log, scene, columns)
    if (np.diff(columns["step"]) <= 0).any():
        raise _undescribed(log, f"the steps of episode {episode} are out of order")
    if columns["action"].min() < 0 or columns["action"].max() >= len(scene.action_names):
        raise _undescribed(log, f"episode {episode} has an action without a name")
    if not all(np.isfinite(columns[name]).all() for name in ("pose", "observation", "next_observation")):
        raise _undescribed(log, f"episode {episode} has a pose or a reading that is no finite number")
    if not 0 <= columns["track"][0] < len(scene.tracks):
        raise _undescribed(log, f"the track of episode {episode} is not attached")
    return EpisodeTrace(scene, columns)


def _check_widths(log: Log, scene: Scene, columns: Mapping[str, NDArray[np.generic]]) -> None:
    """Raises DamagedLogError where the columns have another width than the scene says."""
    if not 0 < len(scene.sensor_angles) <= columns["observation"].shape[1]:
        raise _undescribed(
            log, f"it has {columns['observation'].shape[1]} readings for {len(scene.sensor_angles)} rays"
        )
    for column, names in (("action_value", scene.action_names), ("reward_terms", scene.reward_terms)):
        if columns[column].shape[1] != len(names):
            raise _undescribed(log, f"column '{column}' is {columns[column].shape[1]} wide for {len(names)} names")


def _undescribed(log: Log, found: str) -> DamagedLogError:
    return DamagedLogError(f"log '{log.path}': cannot be drawn: {found}; give the log of a run of carrl train")
