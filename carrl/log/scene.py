"""What a log says of the world that was driven in: sensors, car, tracks; as NumPy arrays, without torch.

Shapes: `P` points of a centreline, `S` walls, `G` gates, `R` rays, `A` actions. Lengths are in metres, angles in
radians counter-clockwise from +x, or from the heading.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carrl.errors import shown

Floats = NDArray[np.float64]

STATE_UNITS = {
    **{"x": "m", "y": "m", "heading": "rad", "speed": "m/s", "yaw_rate": "rad/s", "slip": "rad", "steering": "rad"},
    **{"acceleration": "m/s²", "lateral_acceleration": "m/s²"},
}
"""Of the entries of a vehicle's state that every display knows by their names."""
MOST_MOUNT = 1e9
"""Of a place on the car, m."""
OFF_MAP = 0.1
"""Of the longer side of a track: from so far outside of its walls on, a place is not drawn."""


@dataclass(frozen=True, eq=False)
class TrackShape:
    """A track as it was attached to the log.

    Attributes:
        name: the track's.
        length: of the centreline, m.
        centreline: [P, 2], m, closed, in driving order; point 0 is the start.
        walls: pairs of end points, [S, 2, 2], m.
        gates: (left end, right end) in driving order, the last one the start line, [G, 2, 2], m.
    """

    name: str
    length: float
    centreline: Floats
    walls: Floats
    gates: Floats

    @staticmethod
    def from_json(content: bytes) -> "TrackShape":
        """Reads the attachment `track.json`.

        Raises:
            ValueError: it does not describe a track.
        """
        try:
            document = json.loads(content)
            name, length = document["name"], float(document["length"])
            arrays = [np.array(document[key], dtype=np.float64) for key in ("centreline", "walls", "gates")]
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
            raise ValueError("the attachment does not describe a track") from error
        centreline, walls, gates = arrays
        shapes = (centreline.shape[1:], walls.shape[1:], gates.shape[1:])
        finite = all(np.isfinite(array).all() and array.size for array in arrays) and 0 < length < math.inf
        if not isinstance(name, str) or shapes != ((2,), (2, 2), (2, 2)) or not finite:
            raise ValueError("the attachment does not describe a track")
        return TrackShape(name, length, centreline, walls, gates)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x, least y, greatest x, greatest y of the walls, m."""
        points = self.walls.reshape(-1, 2)
        return (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())

    def on_map(self, places: Floats) -> NDArray[np.bool_]:
        """Which of the places [K, 2] lie between the outermost walls or not far from them, [K]."""
        left, bottom, right, top = self.bounds
        margin = OFF_MAP * max(right - left, top - bottom)
        return np.asarray(
            ((places >= (left - margin, bottom - margin)) & (places <= (right + margin, top + margin))).all(axis=1)
        )


class ObservationPart(NamedTuple):
    """Where a term stands in an observation: its name, how many values, and their bounds."""

    name: str
    width: int
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Scene:
    """What stays the same throughout a log.

    Attributes:
        action_names: what each action is called, A of them: forward, left, right; none where they are numbers.
        control_names: of the vehicle's controls.
        observation: what an observation is made of, in its order.
        reward_terms: what each term of the reward is called.
        sensor_angles: directions of the rays from the heading, right to left, [R], rad.
        sensor_range: distance at which a ray reads 1, m.
        time_step: simulated seconds of a step, s.
        body_radius: of the car's disc, m; half the width of a car that is a rectangle.
        tracks: those that the column `track` counts.
        body_size: length and width of a car that is a rectangle, m.
        sensor_mount: how far ahead of the middle of the car the rays begin, m.
        friction: of the tyres on the road, if it is known: no acceleration is greater than so many times gravity.
    """

    action_names: tuple[str, ...]
    control_names: tuple[str, ...]
    observation: tuple[ObservationPart, ...]
    reward_terms: tuple[str, ...]
    sensor_angles: Floats
    sensor_range: float
    time_step: float
    body_radius: float
    tracks: tuple[TrackShape, ...]
    body_size: tuple[float, float] | None = None
    sensor_mount: float = 0.0
    friction: float | None = None

    @property
    def tells_of_rays(self) -> bool:
        """Whether there is anything in an observation that could be their readings."""
        return any(part.name in ("rays", "scans") for part in self.observation)

    def entries(self) -> dict[str, str]:
        """The scene without its tracks, as entries of a log's metadata; values that are no text are JSON."""
        entries = {
            "action_names": json.dumps(self.action_names),
            "control_names": json.dumps(self.control_names),
            "observation": json.dumps(self.observation),
            "reward_terms": json.dumps(self.reward_terms),
            "sensor_angles_rad": json.dumps(self.sensor_angles.tolist()),
            "sensor_range_m": json.dumps(self.sensor_range),
            "time_step_s": json.dumps(self.time_step),
            "body_radius_m": json.dumps(self.body_radius),
        }
        if self.body_size is not None:
            entries["body_size_m"] = json.dumps(self.body_size)
        if self.sensor_mount:
            entries["sensor_mount_m"] = json.dumps(self.sensor_mount)
        if self.friction is not None:
            entries["friction"] = json.dumps(self.friction)
        return entries

    @staticmethod
    def from_entries(entries: Mapping[str, str], tracks: Sequence[TrackShape]) -> "Scene":
        """Reads what `entries` wrote.

        Raises:
            ValueError: an entry is missing or is not what it should be.
        """
        action_names, reward_terms, control_names = (
            tuple(str(name) for name in _parsed(entries, key, list))
            for key in ("action_names", "reward_terms", "control_names")
        )
        return Scene(
            action_names=action_names,
            control_names=control_names,
            observation=_parts(entries),
            reward_terms=reward_terms,
            sensor_angles=_numbers(entries, "sensor_angles_rad"),
            sensor_range=_positive(entries, "sensor_range_m"),
            time_step=_positive(entries, "time_step_s"),
            body_radius=_positive(entries, "body_radius_m"),
            tracks=tuple(tracks),
            body_size=_size(entries, "body_size_m") if "body_size_m" in entries else None,
            sensor_mount=_number(entries, "sensor_mount_m") if "sensor_mount_m" in entries else 0.0,
            friction=_positive(entries, "friction") if "friction" in entries else None,
        )

    @property
    def rays(self) -> slice:
        """Where the rays' readings stand in an observation, the newest of several scans.

        Raises:
            ValueError: there is no reading for each ray.
        """
        begin, rays = 0, len(self.sensor_angles)
        for part in self.observation:
            scans = part.width / rays if rays else 0
            if (part.name == "rays" and scans == 1) or (part.name == "scans" and scans >= 1 and scans % 1 == 0):
                return slice(begin, begin + rays)
            begin += part.width
        parts = ", ".join(f"{part.width} of {part.name}" for part in self.observation)
        raise ValueError(
            f"it has no reading for each of {len(self.sensor_angles)} rays among {parts or 'nothing':.100}"
        )


def _parts(entries: Mapping[str, str]) -> tuple[ObservationPart, ...]:
    try:
        parts = [
            (str(name), int(width), float(low), float(high))
            for name, width, low, high in _parsed(entries, "observation", list)
        ]
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError("its metadata entry 'observation' does not describe one") from error
    if any(width < 0 for _, width, _, _ in parts):
        raise ValueError("its metadata entry 'observation' has a negative width")
    return tuple(ObservationPart(*part) for part in parts)


def _parsed(entries: Mapping[str, str], key: str, kind: type | tuple[type, ...]) -> Any:
    if key not in entries:
        raise ValueError(f"its metadata has no entry '{key}'")
    try:
        found = json.loads(entries[key])
    except (ValueError, RecursionError) as error:
        raise ValueError(f"its metadata entry '{key}' is not JSON") from error
    if not isinstance(found, kind):
        raise ValueError(f"its metadata entry '{key}' is {shown(found)}")
    return found


def _positive(entries: Mapping[str, str], key: str) -> float:
    try:
        found = float(_parsed(entries, key, (int, float)))
    except OverflowError:  # a whole number larger than any float
        found = math.inf
    if not 0 < found < math.inf:
        raise ValueError(f"its metadata entry '{key}' is {found}; it must be positive")
    return found


def _size(entries: Mapping[str, str], key: str) -> tuple[float, float]:
    found = _numbers(entries, key)
    if found.shape != (2,) or not (found > 0).all():
        raise ValueError(f"its metadata entry '{key}' is {shown(found.tolist())}; it must be a length and a width")
    length, width = found.tolist()
    return length, width


def _number(entries: Mapping[str, str], key: str) -> float:
    found = _parsed(entries, key, (int, float))
    if isinstance(found, bool) or not abs(found) <= MOST_MOUNT:
        raise ValueError(f"its metadata entry '{key}' is {shown(found)}; it must be a number")
    return float(found)


def _numbers(entries: Mapping[str, str], key: str) -> Floats:
    """A row of numbers."""
    found = _parsed(entries, key, list)
    try:
        array = np.array(found, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"its metadata entry '{key}' is no list of numbers") from error
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ValueError(f"its metadata entry '{key}' has the shape {list(array.shape)}, or a value that is no number")
    return array
