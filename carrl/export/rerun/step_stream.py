"""A Rerun recording that knows when the steps of an episode are."""

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from carrl.log.trace import EpisodeTrace
from carrl.render.episode_geometry import steps_of


class StepStream:
    """Sends columns with a row for each of some steps of an episode, and what holds for all of them."""

    def __init__(self, recording: rr.RecordingStream, trace: EpisodeTrace) -> None:
        self._recording = recording
        self._steps = steps_of(trace)
        self._time_step = trace.scene.time_step

    def send(self, path: str, rows: Sequence[int] | NDArray[np.int64], columns: Iterable[rr.ComponentColumn]) -> None:
        """Adds columns to an entity; their n-th row is of the n-th of these rows of the trace, 0 .. T."""
        steps = self._steps[rows]
        times = np.round(steps * self._time_step * 1e9).astype("timedelta64[ns]")
        index = [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("time", duration=times)]
        self._recording.send_columns(path, index, columns)

    def send_static(self, path: str, archetype: rr.AsComponents) -> None:
        """Adds to an entity what holds at all times."""
        self._recording.log(path, archetype, static=True)
