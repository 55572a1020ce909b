"""What may be asked of an evaluation; nothing here waits for torch."""

from typing import Literal

PolicyName = Literal["greedy", "rule", "random", "follow_the_gap", "line"]
"""Who drives: the run's own network, or a baseline."""
MOST_LAPS = 1000
"""Of a drive."""
MOST_STARTS = 2**20
"""Places on a track, from each of which a car starts."""
