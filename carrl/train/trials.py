"""How a run's networks drove when they were tried out in training, as its folder tells; needs no torch."""

import csv
import io
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from carrl.config import MOST
from carrl.errors import CarrlError
from carrl.train.files import EVALUATIONS, read_text

MOST_TRIALS = 2**20
"""That are read from one table."""


@dataclass(frozen=True)
class Trials:
    """What `evaluations.csv` tells of each evaluation, in order.

    Attributes:
        frames: env steps of the run by then, [E].
        laps: share of the drives that completed the lap, [E].
        others: reward of the lap, or mean speed in m/s of a car whose speed varies, [E]; of all drives.
        has_speed: whether it is the speed.
    """

    frames: tuple[int, ...] = ()
    laps: tuple[float, ...] = ()
    others: tuple[float, ...] = ()
    has_speed: bool = False


def read_trials(folder: Path) -> Trials:
    """What `evaluations.csv` tells, up to a row that is damaged."""
    rows: list[tuple[int, float, float]] = []
    name = ""
    with suppress(CarrlError, ValueError, KeyError, TypeError, ZeroDivisionError, csv.Error):
        for row in csv.DictReader(io.StringIO(read_text(folder / EVALUATIONS), newline="")):
            name = "mean_speed" if "mean_speed" in row else "lap_reward"
            drives, completed = int(row.get("drives") or 1), row.get("laps_completed") or row["lap_completed"] == "True"
            figures = (int(row["frames"]), int(completed) / drives, float(row[name]))
            if not all(abs(figure) <= MOST for figure in figures) or len(rows) >= MOST_TRIALS:
                break
            rows.append(figures)
    frames, laps, others = (tuple(column) for column in zip(*rows, strict=True)) if rows else ((), (), ())
    return Trials(frames, laps, others, name == "mean_speed")
