"""A log's columns as NumPy's .npz: each an array [T] or [T, width] of the type that it has in memory."""

from pathlib import Path

import numpy as np

from carrl.log.codec import Selection
from carrl.log.reader import Log


def write_npz(path: Path, log: Log, selection: Selection) -> int:
    """Writes the selected transitions, all of which are in memory then, compressed; returns how many."""
    columns = log.columns(selection)
    with path.open("wb") as file:  # given a name, NumPy appends an ending
        np.savez_compressed(file, allow_pickle=False, **columns)
    return len(columns["action"])
