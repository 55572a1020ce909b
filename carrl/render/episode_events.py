"""What happened in an episode, in words: gates, walls that came too close, and the end."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from carrl.log.trace import EpisodeTrace

Level = Literal["info", "warning", "error"]


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
