"""The lap times of a recorded episode, interpolated within the step.

A lap goes from the gate that the episode began at, or that stands last before its beginning, round to the same gate; so
an episode that begins between two gates has its first lap once it has come to the second passing of that gate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carrl.log.trace import EpisodeTrace
from carrl.sim.crossing import AT_LINE, Floats, crossing_shares, time_shares


@dataclass(frozen=True)
class RecordedLap:
    """One lap.

    Attributes:
        row: of the step in which it ended.
        seconds: that it took.
        counts: whether the car touched no wall.
    """

    row: int
    seconds: float
    counts: bool


def recorded_laps(trace: EpisodeTrace) -> list[RecordedLap]:
    """The laps of an episode in order; none where the log lacks which gate counts, or steps."""
    first, gates = int(trace.columns["next_gate"][0]), trace.track.gates
    if first < 0 or trace.first_step or (np.diff(trace.columns["step"]) != 1).any():
        return []
    own = (first - 1) % len(gates)
    line = np.asarray(gates[own], dtype=np.float64)
    rows = [row for row, gate in trace.passings if gate == own]
    times = [time for row in rows if (time := _crossing_time(trace, line, row)) is not None]
    if len(times) < len(rows):
        return []  # the recorded way does not cross the line where the log says that it does
    if _stands_on(line, trace.poses[0, :2]):
        rows, times = [0, *rows], [0.0, *times]
    contacts = np.asarray(trace.columns.get("collided", np.zeros(len(trace))), dtype=np.bool_)
    touched = np.flatnonzero(contacts.reshape(len(trace), -1).any(axis=1))
    pairs = zip(rows, rows[1:], np.diff(times).tolist(), strict=False)
    return [RecordedLap(end, seconds, not _any_within(touched, begin, end)) for begin, end, seconds in pairs]


def _crossing_time(trace: EpisodeTrace, line: Floats, row: int) -> float | None:
    """When a step crosses the line, since the first step, s."""
    begin, end, speeds = trace.poses[row, :2], trace.poses[row + 1, :2], trace.state("speed")
    with np.errstate(invalid="ignore", over="ignore"):  # a log may say that a car was nowhere
        share = crossing_shares(line, begin, end)
        if speeds is not None:
            share = time_shares(share, speeds[row], speeds[row + 1])
    if not np.isfinite(share):
        return None
    return float(trace.times[row] - trace.times[0] + share * trace.scene.time_step)


def _any_within(rows: NDArray[np.int64], begin: int, end: int) -> bool:
    """Whether any of the rows is between these, both included."""
    return bool(((rows >= begin) & (rows <= end)).any())


def _stands_on(line: Floats, place: Floats) -> bool:
    """Whether a place is on the line between its ends."""
    across, way = line[1] - line[0], place - line[0]
    width = float(np.hypot(*across))
    aside, ahead = way @ across / width, (across[0] * way[1] - across[1] * way[0]) / width
    return bool(abs(ahead) <= AT_LINE and -AT_LINE <= aside <= width + AT_LINE)
