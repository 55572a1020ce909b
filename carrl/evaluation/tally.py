"""Many drives in a few figures, with 95 % confidence intervals."""

import math
from collections.abc import Sequence
from typing import Any

from carrl.evaluation.intervals import mean_interval, rate_interval, share_interval
from carrl.evaluation.rollout import Drive

MEANS = ("progress", "lap_reward", "lap_steps", "forward_share", "switches_per_100m", "near_wall_share")
"""Measures of a drive that are averaged."""


def tally(runs: Sequence[Sequence[Drive]], step_length: float) -> dict[str, Any]:
    """The figures of the drives of one or more runs, ready for JSON.

    The interval of the share of completed laps is Wilson's and that of the collisions per km is the exact one of a
    Poisson rate, both over all drives; that of a mean is Student's, over the runs' means if there are several runs and
    over the drives if there is one.

    Args:
        runs: the drives of each run, at least one of each.
        step_length: metres that a car drives in a step.
    """
    drives = [drive for run in runs for drive in run]
    laps, collisions = sum(drive.lap_completed for drive in drives), sum(drive.collided for drive in drives)
    driven_km = sum(drive.lap_steps for drive in drives) * step_length / 1000
    groups = runs if len(runs) > 1 else [[drive] for drive in drives]
    return {
        "starts": len(drives),
        "laps_completed": laps,
        **{name: _mean(drives, name) for name in MEANS},
        "collisions": collisions,
        "driven_km": driven_km,
        "collisions_per_km": collisions / driven_km,
        "intervals": {
            "completion": share_interval(laps, len(drives)),
            "collisions_per_km": rate_interval(collisions, driven_km),
            **{name: mean_interval([_mean(group, name) for group in groups]) for name in MEANS},
        },
    }


def _mean(drives: Sequence[Drive], name: str) -> float:
    return math.fsum(getattr(drive, name) for drive in drives) / len(drives)
