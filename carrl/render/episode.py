"""One episode as any viewer may draw it: lines on the ground, series and states over its steps, and what happened.

Whatever columns of numbers the log has, beside those that a picture shows, are series by their own names.
Shapes: `T` steps, `R` rays, `N` entries of a series, lines, or steps whose way is known. Lengths are in metres, y to
the left of x.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carrl.log.scene import STATE_UNITS, Floats, TrackShape
from carrl.log.trace import OTHER_POSES, POSE, EpisodeTrace
from carrl.render.colours import BLUE, DARK, ERROR, GREEN, INFO, ORANGE, PURPLE, WARNING, blend
from carrl.render.trail import driven_ways, steps_of, trail_colours

Level = Literal["info", "warning", "error"]
DRAWN = frozenset(
    {
        *("action", "exploratory", "observation", "next_observation", "next_state", "reward", "reward_terms"),
        *("terminated", "truncated", "episode", "step", "car", "track", "time_ns"),
        *("next_gate", "gates_passed", "next_gates_passed", OTHER_POSES, f"next_{OTHER_POSES}"),
    }
)
"""Columns that viewers show otherwise than as series of their own, or not at all."""
SERIES_OF_UNITS = {"rad": "angles", "rad/s": "turning", "m/s²": "accelerations", "m/s": "speeds"}
"""What several entries of a vehicle's state are called together."""
_OTHER_COLOURS = (ERROR, WARNING, DARK.ray, DARK.actions[2], PURPLE, GREEN, BLUE, ORANGE)


@dataclass(frozen=True)
class Event:
    """One line of an episode's story.

    Attributes:
        row: the recorded step in which it happened, 0 .. T - 1.
        level: how bad it is.
        text: what happened.
    """

    row: int
    level: Level
    text: str


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines that stay.

    Attributes:
        name: what they are.
        ends: of each, [N, 2, 2].
        colour: of all of them.
        weight: how wide they are, where walls have 3.
    """

    name: str
    ends: Floats
    colour: str
    weight: float


@dataclass(frozen=True, eq=False)
class Series:
    """Numbers over the steps.

    Attributes:
        name: what they are, of letters, digits and underscores.
        title: what a reader calls them, with their unit.
        entries: what each is called, N of them.
        values: [T, N], or [T + 1, N] for what there is after the last step, too.
        colours: of the entries, [N].
    """

    name: str
    title: str
    entries: Sequence[str]
    values: Floats
    colours: Sequence[str]


@dataclass(frozen=True, eq=False)
class States:
    """Which of some named states holds at each step.

    Attributes:
        name: what they are.
        names: of all states there are.
        values: indices into the names, [T].
        colours: of the states.
    """

    name: str
    names: Sequence[str]
    values: NDArray[np.int64]
    colours: Sequence[str]


@dataclass(frozen=True, eq=False)
class EpisodeScene:
    """An episode, as viewers draw it.

    Attributes:
        trace: its record; poses, rays and times are those of the trace.
    """

    trace: EpisodeTrace

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """Index within the episode of each recorded step, and the one after the last, [T + 1]."""
        return steps_of(self.trace)

    @property
    def action_colours(self) -> tuple[str, ...]:
        """Of each action."""
        return DARK.action_colours(len(self.trace.scene.action_names))

    @property
    def track(self) -> list[Lines]:
        """Centreline, gates, start line and walls, the last on top."""
        track = self.trace.track
        loop = np.stack([track.centreline, np.roll(track.centreline, -1, axis=0)], axis=1)
        return [
            Lines("centreline", loop, DARK.centreline, 1.0),
            Lines("gates", track.gates[:-1], DARK.gate, 2.0),
            Lines("start", track.gates[-1:], DARK.start, 2.0),
            Lines("walls", track.walls, DARK.wall, 3.0),
        ]

    @cached_property
    def trail(self) -> tuple[NDArray[np.int64], Floats, list[str]]:
        """Rows of the steps whose way is known, [N], both ends of each way, [N, 2, 2], and its colour.

        That is of the step's action, or where the speed varies of the speed.
        """
        rows, ways = driven_ways(self.trace)
        palette, colours = trail_colours(self.trace, DARK)
        return rows, ways, [palette[colour] for colour in colours[rows]]

    @property
    def hits(self) -> NDArray[np.bool_]:
        """Whether each ray meets a wall, before each step and after the last, [T + 1, R]."""
        return self.trace.ranges < self.trace.scene.sensor_range

    @property
    def states(self) -> list[States]:
        """The action of each step, if actions have names, and whether it was chosen by chance, if the log tells."""
        trace, found = self.trace, []
        if trace.controls is None:
            found.append(States("action", trace.scene.action_names, trace.actions, self.action_colours))
        if trace.controls is None or "exploratory" in trace.columns:
            random = trace.exploratory.astype(np.int64)
            found.append(States("choice", ("greedy", "random"), random, (INFO, WARNING)))
        return found

    @property
    def series(self) -> list[Series]:
        """What the log has of numbers, the reward with its terms and its sum, and what the rays read."""
        return [*self.controls, *self.columns, self._reward(), *self._ranges()]

    @property
    def controls(self) -> list[Series]:
        """What was done with the car, where that is numbers."""
        controls, names = self.trace.controls, self.trace.scene.control_names
        if controls is None:
            return []
        return [Series("action", "controls, -1 to 1", names, controls, _colours(len(names)))]

    @cached_property
    def columns(self) -> list[Series]:
        """The log's own columns of numbers, but for those that are drawn."""
        found = []
        for name, column in self.trace.columns.items():
            if name in DRAWN or not np.issubdtype(column.dtype, np.floating):
                continue
            values = np.asarray(column, dtype=np.float64).reshape(len(column), -1)
            entries = self._entries(name, values.shape[1])
            if name == "state":  # the pose, which it begins with, is drawn
                found += _by_unit(entries[len(POSE) :], self.trace.states[:, len(POSE) :])
                continue
            if not entries:
                continue
            colours = _colours(len(entries)) if entries != self.trace.scene.action_names else self.action_colours
            found.append(Series(name, name.replace("_", " "), entries, values, colours))
        return found

    @property
    def events(self) -> list[Event]:
        """What happened, in words."""
        return episode_events(self.trace)

    @property
    def facts(self) -> dict[str, str | int | float]:
        """The episode as a whole."""
        return {
            "episode": self.trace.episode,
            "car": self.trace.car,
            "track": self.trace.track.name,
            "steps": len(self.trace),
            "episode_return": float(self.trace.rewards.sum()),
            "gates": int(self.trace.gates_passed[-1]),
            "ended": self.trace.ended,
        }

    @property
    def digest(self) -> bytes:
        """What the same steps always have, and other steps never, 16 bytes."""
        digest = hashlib.sha256()
        for name in sorted(self.trace.columns):
            digest.update(name.encode() + self.trace.columns[name].tobytes())
        return digest.digest()[:16]

    @property
    def per_action(self) -> Series | None:
        """The first of these columns that has a number for each action, such as Q-values."""
        names = self.trace.scene.action_names
        return next((series for series in self.columns if tuple(series.entries) == names), None)

    @property
    def numbers(self) -> list[Series]:
        """The others of these columns."""
        return [series for series in self.columns if series is not self.per_action]

    @property
    def told(self) -> list[Series]:
        """Those of them that the algorithm told, and not the car."""
        return [series for series in self.numbers if series.name in self.trace.columns and series.name != "state"]

    def _entries(self, column: str, width: int) -> tuple[str, ...]:
        """What the values of a column's row are called."""
        actions = self.trace.scene.action_names
        if column == "action_value" and len(actions) == width:
            return actions
        names = tuple(self.trace.entries.get(column, ()))
        if len(names) == width:
            return names
        return (column,) if width == 1 else tuple(f"{column} {index}" for index in range(width))

    def _reward(self) -> Series:
        rewards, terms = self.trace.rewards, self.trace.scene.reward_terms
        values = np.column_stack([rewards.cumsum(), rewards, self.trace.reward_terms])
        colours = INFO, DARK.start, *_colours(len(terms))
        return Series(
            "reward", "reward, its terms, and the return so far", ("return so far", "reward", *terms), values, colours
        )

    def _ranges(self) -> list[Series]:
        """What the rays read, m, coloured from blue on the right over green to red on the left."""
        angles = self.trace.scene.sensor_angles
        if not len(angles):
            return []
        shares = np.linspace(-1, 1, len(angles)) if len(angles) > 1 else np.zeros(1)
        colours = [blend(DARK.ray, DARK.actions[1] if share > 0 else DARK.actions[2], abs(share)) for share in shares]
        title = "sensor rays, m: left red, ahead green, right blue"
        return [Series("ranges", title, [direction(angle) for angle in angles], self.trace.ranges, colours)]


def _colours(count: int) -> tuple[str, ...]:
    """Of entries that have no colour of their own."""
    return tuple(_OTHER_COLOURS[entry % len(_OTHER_COLOURS)] for entry in range(count))


def _by_unit(names: Sequence[str], values: Floats) -> list[Series]:
    """Entries of the state before each step and after the last, [T + 1, S]: those of one unit together."""
    units = {name: STATE_UNITS.get(name, "") for name in names}
    found = []
    for unit in dict.fromkeys(units.values()):
        rows = [row for row, name in enumerate(names) if units[name] == unit]
        entries = [names[row] for row in rows]
        name = entries[0] if unit and len(rows) == 1 else SERIES_OF_UNITS.get(unit, "state")
        title = f"{name.replace('_', ' ')}, {unit}" if unit else name
        found.append(Series(name, title, entries, values[:, rows], _colours(len(rows))))
    return found


def episode_events(trace: EpisodeTrace) -> list[Event]:
    """All that is worth telling of an episode, in the order in which it happened."""
    events = [_beginning(trace), *_gates(trace), *_near_walls(trace)]
    return [*sorted(events, key=lambda event: event.row), _end(trace)]


def _beginning(trace: EpisodeTrace) -> Event:
    where = f"episode {trace.episode} of car {trace.car} on track {trace.track.name}"
    late = f", recorded from step {trace.first_step}" if trace.first_step else ""
    return Event(0, "info", f"{where}{late}")


def _gates(trace: EpisodeTrace) -> Iterator[Event]:
    """A line for each step that passed gates; one that completes a lap says so, unless earlier gates are unknown."""
    gates, known = len(trace.track.gates), not trace.first_step or trace.columns["next_gate"][0] >= 0
    before, after = trace.columns["gates_passed"], trace.columns["next_gates_passed"]
    for row in np.flatnonzero(after > before).tolist():
        count, laps = int(after[row]), int(after[row]) // gates
        lap = f", lap {laps} complete" if known and laps > before[row] // gates else ""
        yield Event(row, "info", f"{count} gate{'s' * (count > 1)} passed{lap}")


def _near_walls(trace: EpisodeTrace) -> Iterator[Event]:
    """A line whenever the car comes too near to a wall, not for every step that it stays there."""
    if "proximity" not in trace.scene.reward_terms:
        return
    near = trace.reward_terms[:, trace.scene.reward_terms.index("proximity")] < 0
    for row in np.flatnonzero(near & ~np.append(False, near[:-1])):
        ranges = trace.ranges[row + 1]
        if not len(ranges):
            yield Event(int(row), "warning", "near a wall")
            continue
        side = direction(trace.scene.sensor_angles[ranges.argmin()])
        yield Event(int(row), "warning", f"near a wall: {ranges.min():.2f} m {side}")


def _end(trace: EpisodeTrace) -> Event:
    level: Level = "error" if trace.ended == "collision" else "info"
    what = "the record ends within the episode" if trace.ended == "unfinished" else trace.ended
    return Event(len(trace) - 1, level, f"{what} after {len(trace)} steps, reward {trace.rewards.sum():g} in all")


def direction(angle: float) -> str:
    """An angle from the heading, rad counter-clockwise, in words: 30° left, ahead."""
    degrees = round(np.degrees(angle))
    return f"{abs(degrees)}° {'left' if degrees > 0 else 'right'}" if degrees else "ahead"


def connected_walls(track: TrackShape) -> list[Floats]:
    """The walls as lines of points, [N, 2] each, m: each goes on where the next wall begins.

    Most tracks have two, the left and the right one, each closed: its last point is its first.
    """
    breaks = np.flatnonzero((track.walls[1:, 0] != track.walls[:-1, 1]).any(axis=1)) + 1
    return [np.vstack([line[:, 0], line[-1:, 1]]) for line in np.split(track.walls, breaks)]
