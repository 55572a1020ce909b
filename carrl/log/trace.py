"""One episode of a log, ready to be looked at: what the car saw, chose and got, step by step.

Shapes: `T` steps, `R` rays, `A` actions, `K` terms of the reward.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carrl.errors import DamagedLogError, LogError
from carrl.log.codec import Columns, Selection
from carrl.log.log_file import ATTACHMENT
from carrl.log.messages import Ended, how_ended
from carrl.log.reader import Log
from carrl.log.scene import Floats, Scene, TrackShape

_GREATEST = 1e30
"""Of a reading, which should be 1 at most: single precision must hold where its ray ends."""
POSE = ("x", "y", "heading")
"""What every state begins with: m, m, rad."""
OTHER_POSES = "other_poses"
"""The column of the poses of the other cars of a world; `next_` and that of those after the action."""
LEAST_SPREAD = 0.1
"""Between the greatest and the least speed of a car whose speed varies, m/s."""
_TRACK_NAME = re.compile(r"track(?:-(\d{1,6}))?\.json")


@dataclass(frozen=True, eq=False)
class EpisodeTrace:
    """The recorded steps of one episode, at least one.

    Attributes:
        scene: sensors, car and tracks.
        columns: of the log, by name, each [T, ...], in the order of the steps.
        entries: what the values of a column's row are called, by the name of the column, if they have names.
        ends_with_laps: whether it was to end with its last lap, as the drives of an evaluation do.
    """

    scene: Scene
    columns: Columns
    entries: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    ends_with_laps: bool = False

    def __len__(self) -> int:
        """Steps, T."""
        return len(self.columns["action"])

    @property
    def episode(self) -> int:
        """Number of the episode within the run."""
        return int(self.columns["episode"][0])

    @property
    def car(self) -> int:
        """Index of the car among those simulated side by side."""
        return int(self.columns["car"][0])

    @property
    def track(self) -> TrackShape:
        """Where it was driven."""
        return self.scene.tracks[int(self.columns["track"][0])]

    @property
    def ended(self) -> Ended | Literal["laps complete", "unfinished"]:
        """Why the record ends; a drive that was cut with its last lap has come to its end."""
        terminated, truncated = (bool(self.columns[name][-1].any()) for name in ("terminated", "truncated"))
        if not terminated and not truncated:
            return "unfinished"
        gates = int(self.gates_passed[-1])
        if self.ends_with_laps and not terminated and gates and gates % len(self.track.gates) == 0:
            return "laps complete"
        collided = self.columns.get("collided", self.columns["terminated"])  # there if something else ends episodes
        return how_ended(terminated, bool(collided[-1].any()))

    @property
    def first_step(self) -> int:
        """Index of the first recorded step within the episode; 0 unless the log lacks the episode's beginning."""
        return int(self.columns["step"][0])

    @property
    def actions(self) -> NDArray[np.int64]:
        """Of each step, indices into `scene.action_names`, [T]."""
        return action_choices(self.columns)

    @property
    def controls(self) -> Floats | None:
        """Of each step, named by `scene.control_names`, each in [-1, 1], [T, C]; None where actions have names."""
        if self.columns["action"].dtype.kind != "f":
            return None
        return np.asarray(self.columns["action"], dtype=np.float64).reshape(len(self), -1)

    @property
    def rewards(self) -> Floats:
        """Of each step, [T]."""
        return np.asarray(self.columns["reward"], dtype=np.float64)[:, 0]

    @property
    def reward_terms(self) -> Floats:
        """The reward of each step, split into `scene.reward_terms`, [T, K]."""
        return np.asarray(self.columns["reward_terms"], dtype=np.float64)

    @property
    def exploratory(self) -> NDArray[np.bool_]:
        """Whether each step's action was drawn at random, [T]."""
        return np.asarray(self.columns.get("exploratory", np.zeros(len(self))), dtype=np.bool_)

    @cached_property
    def times(self) -> Floats:
        """Simulated time since the start of the run, before each step and after the last, [T + 1], s."""
        begin = np.asarray(self.columns["time_ns"], dtype=np.int64) / 1e9
        return np.append(begin, begin[-1] + self.scene.time_step)

    @cached_property
    def states(self) -> Floats:
        """The whole state of the vehicle before each step and after the last, [T + 1, S]."""
        return np.vstack([self.columns["state"], self.columns["next_state"][-1:]]).astype(np.float64)

    @cached_property
    def others(self) -> Floats:
        """Where the M other cars of the world were, as `poses` has it, [T + 1, M, 3]; M is 0 if the log has none."""
        if OTHER_POSES not in self.columns:
            return np.zeros((len(self) + 1, 0, 3))
        seen = [self.columns[OTHER_POSES], self.columns[f"next_{OTHER_POSES}"][-1:]]
        return np.vstack(seen).astype(np.float64).reshape(len(self) + 1, -1, 3)

    @property
    def poses(self) -> Floats:
        """Where the car was, x m, y m, heading rad, before each step and after the last, [T + 1, 3]."""
        return self.states[:, :3]

    def state(self, name: str) -> Floats | None:
        """One entry of the state before each step and after the last, [T + 1]; None if the vehicle has none such."""
        names = self.entries.get("state", ())
        return self.states[:, names.index(name)] if name in names else None

    @cached_property
    def speeds(self) -> Floats | None:
        """Before each step and after the last, [T + 1], m/s; None of a car whose speed does not vary."""
        speeds = self.state("speed")
        return None if speeds is None or np.ptp(speeds) < LEAST_SPREAD else speeds

    @cached_property
    def origins(self) -> Floats:
        """Where the rays begin, before each step and after the last, [T + 1, 2], m."""
        return ray_origins(self.poses, self.scene.sensor_mount)

    @cached_property
    def ranges(self) -> Floats:
        """What each ray read before each step and after the last, [T + 1, R], m."""
        if not len(self.scene.sensor_angles) and not self.scene.tells_of_rays:
            return np.zeros((len(self) + 1, 0))
        seen = [self.columns["observation"], self.columns["next_observation"][-1:]]
        readings = np.vstack(seen)[:, self.scene.rays].astype(np.float64)
        return np.where(np.isfinite(readings), readings.clip(-_GREATEST, _GREATEST), readings) * self.scene.sensor_range

    @cached_property
    def gates_passed(self) -> NDArray[np.int64]:
        """How many gates of the episode were passed before each step and after the last, [T + 1]."""
        return np.append(self.columns["gates_passed"], self.columns["next_gates_passed"][-1]).astype(np.int64)

    @cached_property
    def passings(self) -> list[tuple[int, int]]:
        """Every passing of a gate: the row of the step, and the gate, index into those of the track; -1 if unknown."""
        first, gates = self.columns["next_gate"], len(self.track.gates)
        counts = self.columns["next_gates_passed"] - self.columns["gates_passed"]
        return [
            (row, int(first[row] + nth) % gates if first[row] >= 0 else -1)
            for row in np.flatnonzero(counts > 0).tolist()
            for nth in range(counts[row])
        ]

    def ray_ends(self) -> Floats:
        """Where the rays end, before each step and after the last, [T + 1, R, 2], m."""
        angles = self.poses[:, 2:] + self.scene.sensor_angles
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return np.asarray(self.origins[:, None] + self.ranges[:, :, None] * directions)


def ray_origins(poses: NDArray[np.floating[Any]], mount: float) -> Floats:
    """Where the rays of cars at poses [..., 3] begin that are mounted so far ahead of the middle, [..., 2], m."""
    ahead = np.stack([np.cos(poses[..., 2]), np.sin(poses[..., 2])], axis=-1)
    return np.asarray(poses[..., :2] + mount * ahead, dtype=np.float64)


def read_scene(log: Log) -> Scene:
    """The world that a log was recorded in.

    Raises:
        DamagedLogError: the log's metadata or attachments do not describe one.
    """
    own = [name for name in log.attachments if ATTACHMENT + name in log.metadata]
    numbers = {name: int(match[1] or 0) for name in own if (match := _TRACK_NAME.fullmatch(name))}
    try:
        tracks = [TrackShape.from_json(log.attachment(name)) for name in sorted(numbers, key=numbers.__getitem__)]
        return Scene.from_entries(log.scene_entries, tracks)
    except ValueError as error:
        raise _undescribed(log, str(error)) from error


def with_choices(scene: Scene) -> Scene:
    """The scene with one name for every action where none has a name, and no rays where observations tell of none."""
    scene = scene if scene.action_names else replace(scene, action_names=("continuous",))
    return scene if scene.tells_of_rays else replace(scene, sensor_angles=np.zeros(0))


def action_choices(columns: Columns) -> NDArray[np.int64]:
    """Of each step, which of the scene's named actions was chosen, [T]; 0 where actions are numbers."""
    actions = columns["action"]
    return np.asarray(actions if actions.dtype.kind == "i" else np.zeros(len(actions)), dtype=np.int64)


def read_trace(log: Log, episode: int) -> EpisodeTrace:
    """One episode of a log.

    Raises:
        LogError: the log holds no transition of it.
        DamagedLogError: it is not an intact log.
    """
    scene = with_choices(read_scene(log))
    columns = log.columns(Selection(episodes=[episode]))
    if not len(columns["action"]):
        raise LogError(f"log '{log.path}': holds no step of episode {episode}; carrl log ls FILE shows which it has")
    try:
        _check_columns(scene, columns)
    except ValueError as error:
        raise _undescribed(log, str(error)) from error
    entries = {column.name: column.entries for column in log.schema.columns}
    return EpisodeTrace(scene, columns, entries, ends_with_laps="policy" in log.metadata)


def _check_columns(scene: Scene, columns: Columns) -> None:
    """Raises ValueError where the columns of an episode are others than the scene says, or make no sense."""
    episode = int(columns["episode"][0])
    if scene.tells_of_rays and (found := columns["observation"].shape[1]) < scene.rays.stop:
        raise ValueError(f"it has {found} readings for {len(scene.sensor_angles)} rays")
    named = columns["action"].dtype.kind == "i"
    for column, names in (("action_value", scene.action_names), ("reward_terms", scene.reward_terms)):
        if column in columns and (named or column != "action_value") and columns[column].shape[1] != len(names):
            raise ValueError(f"column '{column}' is {columns[column].shape[1]} wide for {len(names)} names")
    if OTHER_POSES in columns:
        _check_others(columns)
    if columns["state"].shape[1] < len(POSE):
        raise ValueError("its states have no x, y and heading")
    if (np.diff(columns["step"]) <= 0).any():
        raise ValueError(f"the steps of episode {episode} are out of order")
    controls = 1 if columns["action"].ndim == 1 else columns["action"].shape[1]
    if not named and (controls != len(scene.control_names) or not np.isfinite(columns["action"]).all()):
        raise ValueError(
            f"episode {episode} has actions that are no number for each of {len(scene.control_names)} controls"
        )
    actions = action_choices(columns)
    if actions.min() < 0 or actions.max() >= len(scene.action_names):
        raise ValueError(f"episode {episode} has an action without a name")
    if not all(np.isfinite(columns[name]).all() for name in ("state", "observation", "next_observation")):
        raise ValueError(f"episode {episode} has a state or a reading that is no finite number")
    if not np.isfinite(columns["next_state"][-1]).all():
        raise ValueError(f"it is not known where episode {episode} ended")
    if not 0 <= columns["track"][0] < len(scene.tracks):
        raise ValueError(f"the track of episode {episode} is not attached")
    gates, passed = len(scene.tracks[columns["track"][0]].gates), columns["next_gates_passed"] - columns["gates_passed"]
    if columns["next_gate"].max() >= gates or passed.min() < 0 or passed.max() > gates:
        raise ValueError(f"episode {episode} passed gates that its track does not have")


def _check_others(columns: Columns) -> None:
    """Raises ValueError where the poses of the other cars are none."""
    both = [columns.get(name, np.zeros(0)) for name in (OTHER_POSES, f"next_{OTHER_POSES}")]
    if any(each.ndim != 2 or each.shape != both[0].shape or each.shape[1] % len(POSE) for each in both):
        raise ValueError(f"its columns '{OTHER_POSES}' and 'next_{OTHER_POSES}' are no poses of the same cars")
    if not all(each.dtype.kind == "f" and np.isfinite(each).all() for each in both):
        raise ValueError("another car has a pose that is no finite number")


def _undescribed(log: Log, found: str) -> DamagedLogError:
    return DamagedLogError(f"log '{log.path}': cannot be drawn: {found}; give the log of a run of carrl train")
