"""What may be asked of an evaluation; nothing here waits for torch."""

import os
from pathlib import Path
from typing import Literal

from carrl.errors import ConfigError
from carrl.files import check_may_appear

PolicyName = Literal["greedy", "rule", "random", "follow_the_gap", "line"]
"""Who drives: the run's own network, or a baseline."""
MOST_LAPS = 1000
"""Of a drive."""
MOST_RACES = 1000
"""On a track, which are driven side by side."""
MOST_STARTS = 2**20
"""Places on a track, from each of which a car starts."""


def check_one_drives(runs: int) -> None:
    """Raises ConfigError where there are several policies, whose drives one log, or one window, cannot tell apart."""
    if runs > 1:
        raise ConfigError(f"one policy can be watched and kept at a time, and here are {runs}; name the folder of one")


def check_is_free(log: str | Path) -> None:
    """Tells before long work that no log can be written there.

    Raises:
        CarrlError: the name has another ending, there is a file already, or none can appear.
    """
    if Path(log).suffix.lower() != ".mcap":
        raise ConfigError(f"'{log}' is no name of a log; it must end in .mcap")
    if os.path.lexists(log):
        raise ConfigError(f"'{log}' exists, and no log is written over another file; choose another name")
    check_may_appear(log)
