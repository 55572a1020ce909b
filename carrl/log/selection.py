"""Which of a log's transitions to read."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from carrl.log.codec import Columns


@dataclass(frozen=True)
class Selection:
    """Which transitions to read; everything by default.

    Attributes:
        episodes: numbers of episodes; None for all.
        envs: indices of cars; None for all.
        begin_s: simulated time of the first, s.
        end_s: simulated time before which the last one begins, s.
    """

    episodes: Collection[int] | None = None
    envs: Collection[int] | None = None
    begin_s: float | None = None
    end_s: float | None = None

    @property
    def span_ns(self) -> tuple[float, float]:
        """Begin and end of the time, ns."""
        begin = -np.inf if self.begin_s is None else self.begin_s * 1e9
        return begin, np.inf if self.end_s is None else self.end_s * 1e9

    def of(self, columns: Columns) -> Columns:
        """Those of the columns' transitions that are selected."""
        begin, end = self.span_ns
        times = columns["time_ns"]
        wanted = (times >= begin) & (times < end)
        if self.episodes is not None:
            wanted &= np.isin(columns["episode"], list(self.episodes))
        if self.envs is not None:
            wanted &= np.isin(columns["env"], list(self.envs))
        return columns if wanted.all() else {name: values[wanted] for name, values in columns.items()}


EVERYTHING = Selection()
