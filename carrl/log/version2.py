"""Logs of format version 2, turned into what version 3 has as soon as they are read.

Version 2 knew one vehicle and one algorithm: its columns are fixed, but for their widths. It lacks the state after a
step, which follows from the recorded pose and the action (the metadata say how each action moves the car), and it does
not number the gates: those passed are counted by the reward for them, from the first step read on, and which gate is
next nobody knows (-1).

Shape letters: `T` transitions.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from carrl.log.codec import Columns, parse_message
from carrl.log.schema import Column, Schema

VERSION = 2
LACKS = (
    "version 2 holds no state after a step (next_state is computed from the pose and the action) and numbers no gates "
    "(gates_passed is counted by the gate reward, next_gate is -1, not known)"
)
"""What to say of such a log."""

_POSE = ("x", "y", "heading")
_DISTANCES = "distance to the wall along each ray / sensor range, 0..1"
_TABLE = (
    Column(
        "observation", "observation", "float32", (0,), f"{_DISTANCES}, before the action; then what else is observed"
    ),
    Column("action", "action", "int64", (), "index of the action", narrow=True),
    Column("reward", ("next", "reward"), "float32", (1,), "sum of the reward terms"),
    Column("reward_terms", ("next", "reward_terms"), "float32", (0,), "what each term paid, in their order"),
    Column("next_observation", ("next", "observation"), "float32", (0,), f"{_DISTANCES}, after the action"),
    Column("terminated", ("next", "terminated"), "bool", (1,), "the episode ended here, in a terminal state"),
    Column("truncated", ("next", "truncated"), "bool", (1,), "the episode was cut here, in no terminal state"),
    Column("episode", "episode", "int64", (), "number of the episode within the run"),
    Column("step", "step", "int64", (), "index of the transition within its episode, from 0", narrow=True),
    Column("env", "car", "int64", (), "index of the car among those simulated side by side, from 0", narrow=True),
    Column("pose", "pose", "float32", (3,), "x m, y m, heading rad, before the action", _POSE),
    Column("action_value", "action_value", "float32", (0,), "Q-values of the actions, in their order"),
    Column("epsilon", "epsilon", "float32", (), "probability with which an action was drawn at random"),
    Column("exploratory", "exploratory", "bool", (), "the action was drawn at random"),
    Column("track", "track", "int64", (), "index of the track that the car was on", narrow=True),
    Column("time_ns", "time_ns", "int64", (), "simulated time before the action, since the start of the run, ns"),
)
"""The columns in the order of the file; a width of 0 is one that the first message tells."""
_ALGORITHM = ("action_value", "epsilon", "exploratory")
_RENAMED = {"env": "car", "pose": "state"}
_ADDED = (
    Column(
        "next_state", ("next", "pose"), "float32", (3,), "x m, y m, heading rad, after the action (computed)", _POSE
    ),
    Column("next_gate", "next_gate", "int64", (), "-1: version 2 does not say"),
    Column("gates_passed", "gates_passed", "int64", (), "gates passed before the action, counted by the rewards"),
    Column(
        "next_gates_passed", ("next", "gates_passed"), "int64", (), "gates passed after the action, counted likewise"
    ),
)


@cache
def _file_schema(widths: tuple[int, ...]) -> Schema:
    free = iter(widths)
    return Schema(tuple(replace(c, shape=(next(free),)) if c.shape == (0,) else c for c in _TABLE), version=VERSION)


NO_WIDTHS = _file_schema((0, 0, 0, 0))
"""Of a log without transitions."""


def file_schema(message: bytes) -> Schema:
    """The columns of this message of transitions, with their widths.

    Raises:
        ValueError: it is none.
    """
    wire = parse_message(NO_WIDTHS.message_class, message)
    widths = [len(getattr(wire, c.name)) // (4 * wire.count) if wire.count else 0 for c in _TABLE if c.shape == (0,)]
    if widths[0] != widths[2]:
        raise ValueError(f"column 'next_observation' has width {widths[2]}; expected {widths[0]}, as 'observation'")
    return _file_schema(tuple(widths))


class Version2:
    """What a reader needs of such a log.

    Attributes:
        schema: the columns as version 3 calls them.
        scene_entries: what version 3's metadata would say of the world, so far as it is known.
    """

    def __init__(self, found: Schema, metadata: Mapping[str, str]) -> None:
        """Takes the columns of the file, and its metadata."""
        actions, terms = _names(metadata, "action_names"), _names(metadata, "reward_terms")
        entries = {"action_value": actions, "reward_terms": terms}
        columns = [_named(column, entries.get(column.name, column.entries)) for column in found.columns]
        self.schema = Schema(
            (*(column for column in columns if column.name not in _ALGORITHM), *_ADDED),
            tuple(column for column in columns if column.name in _ALGORITHM),
            VERSION,
        )
        self._gate_term = terms.index("gate") if "gate" in terms else None
        self._motions = _motions(metadata)
        self._passed: dict[int, tuple[int, int]] = {}
        width, rays = found.by_name["observation"].width, len(_listed(metadata, "sensor_angles_rad"))
        parts = [["rays", rays, 0.0, 1.0]] + ([["others", width - rays, -1.0, 1.0]] if width > rays else [])
        self.scene_entries = {**metadata, "control_names": "[]", "observation": json.dumps(parts)}

    def columns(self, found: Mapping[str, np.ndarray]) -> Columns:
        """The columns [T] of version 3; to be called once for each batch, in their order."""
        columns = {_RENAMED.get(name, name): values for name, values in found.items()}
        columns["next_state"] = self._states_after(columns["state"], columns["action"])
        columns["next_gate"] = np.full(len(columns["action"]), -1)
        before, after = self._gates(columns["car"], columns["episode"], columns["reward_terms"])
        return columns | {"gates_passed": before, "next_gates_passed": after}

    def _states_after(self, poses: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Where each action led to, [T, 3]; not a number where the log does not say how it moves the car."""
        known = (actions >= 0) & (actions < len(self._motions))
        distance, bearing, yaw = np.vstack([self._motions, [np.nan] * 3])[np.where(known, actions, -1)].T
        x, y, heading = poses.astype(np.float64).T
        direction = heading + bearing
        after = np.stack([x + distance * np.cos(direction), y + distance * np.sin(direction), heading + yaw], axis=1)
        return after.astype(np.float32)

    def _gates(self, cars: np.ndarray, episodes: np.ndarray, terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How many gates each car had passed in its episode before and after the step, [T] each."""
        passes = np.zeros(len(cars), dtype=np.int64)
        if self._gate_term is not None and self._gate_term < terms.shape[1]:
            passes += terms[:, self._gate_term] > 0
        after = np.empty_like(passes)
        for car in np.unique(cars).tolist():
            rows = np.flatnonzero(cars == car)
            begins = np.append(0, np.flatnonzero(np.diff(episodes[rows])) + 1)
            for episode_rows in np.split(rows, begins[1:]):
                episode = int(episodes[episode_rows[0]])
                last_episode, count = self._passed.get(car, (-1, 0))
                count = count if episode == last_episode else 0
                after[episode_rows] = count + passes[episode_rows].cumsum()
                self._passed[car] = episode, int(after[episode_rows[-1]])
        return after - passes, after


def _named(column: Column, entries: Sequence[str]) -> Column:
    """The column as version 3 calls it, with the names of its entries if they are as many."""
    fitting = tuple(entries) if len(entries) == column.width else ()
    return replace(column, name=_RENAMED.get(column.name, column.name), entries=fitting)


def _motions(metadata: Mapping[str, str]) -> np.ndarray:
    """How a step of each action moves the car: distance m, its bearing from the heading rad, change of heading rad."""
    try:
        found = np.array(_listed(metadata, "manoeuvres"), dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        return np.empty((0, 3))
    return found if found.ndim == 2 and found.shape[1] == 3 and np.isfinite(found).all() else np.empty((0, 3))


def _names(metadata: Mapping[str, str], key: str) -> list[str]:
    return [str(name) for name in _listed(metadata, key)]


def _listed(metadata: Mapping[str, str], key: str) -> list[object]:
    """A list that the metadata hold as JSON; an empty one if they do not."""
    try:
        found = json.loads(metadata.get(key, "[]"))
    except (ValueError, RecursionError):
        return []
    return found if isinstance(found, list) else []
