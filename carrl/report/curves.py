"""Curves of a group: return against frames, and the share of runs that reach a score or lap by a time.

Shapes: `N` runs of a group, `T` points of a curve.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carrl.report.comparison import values_of
from carrl.report.groups import Group
from carrl.report.measures import FIRST_LAP_FRAMES, Measure
from carrl.report.statistics import Band, Floats, iqm_band, share_band

POINTS = 201
"""On the horizontal axis, the same for all groups."""


@dataclass(frozen=True)
class Curve:
    """A curve of a group with its 95 % band.

    Attributes:
        label: the group's.
        runs: how many it is of.
        points: on the horizontal axis, [T].
        band: interquartile mean or share there.
    """

    label: str
    runs: int
    points: Floats
    band: Band


def return_curves(groups: Sequence[Group]) -> list[Curve]:
    """The interquartile mean over runs of the mean return of the last 20 episodes, by env steps.

    Each curve spans the frames in which all runs of its group have one: from the last of their first episodes' ends to
    the first of the runs' ends. Between two ends of episodes a run keeps its value; nothing is interpolated ahead.
    """
    driven = {group.label: [run for run in group.counted if run.ends.frames] for group in groups}
    last = max((run.summary["frames"] for runs in driven.values() for run in runs if run.summary), default=0)
    grid = np.linspace(0, last, POINTS)
    curves = []
    for label, runs in driven.items():
        if runs:
            begin = max(run.ends.frames[0] for run in runs)
            end = min(run.summary["frames"] for run in runs if run.summary)
            points = grid[(grid >= begin) & (grid <= end)]
            if len(points):
                held = [_held(run.ends.frames, run.ends.mean_returns, points) for run in runs]
                curves.append(Curve(label, len(runs), points, iqm_band(np.stack(held))))
    return curves


def lap_profiles(groups: Sequence[Group]) -> list[Curve]:
    """The share of runs that have lapped by each frame, up to where the first run of the group ended."""
    firsts = {group.label: values_of(group, FIRST_LAP_FRAMES) for group in groups}
    ends = {
        group.label: min((run.summary["frames"] for run in group.counted if run.summary), default=0) for group in groups
    }
    grid = np.linspace(0, max(ends.values(), default=0), POINTS)
    return [
        Curve(label, len(values), points, share_band(np.array(values)[:, None] <= points))
        for label, values in firsts.items()
        if values and len(points := grid[grid <= ends[label]])
    ]


def score_profiles(groups: Sequence[Group], measure: Measure) -> list[Curve]:
    """The share of runs above each score: the performance profiles of Agarwal et al. (2021)."""
    scores = {group.label: values_of(group, measure) for group in groups}
    pooled = [score for values in scores.values() for score in values if math.isfinite(score)]
    if not pooled:
        return []
    margin = 0.05 * (max(pooled) - min(pooled)) or 1.0
    grid = np.linspace(min(pooled) - margin, max(pooled) + margin, POINTS)
    return [
        Curve(label, len(values), grid, share_band(np.array(values)[:, None] > grid))
        for label, values in scores.items()
        if values
    ]


def _held(frames: Sequence[int], values: Sequence[float], points: Floats) -> Floats:
    """The value at the last of the frames that is not after each point, [T]."""
    held: Floats = np.asarray(values, dtype=np.float64)[np.searchsorted(frames, points, side="right") - 1]
    return held
