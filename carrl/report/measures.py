"""What runs are compared by, and the statistics of few runs: means, intervals and probabilities of improvement.

Smoothness, lap time and speed are those of the best greedy rollout and count only where that completes the lap: a car
that crashes before the first corner has not changed its action once. A run without a first lap, or whose first lap is
not confirmed, has it after all others'. Returns and rewards are on the same scale only where the track and what is paid
for are the same, and lap times where the track and the number of starts are.

Source: R. Agarwal et al. (2021), Deep Reinforcement Learning at the Edge of the Statistical Precipice, and their
library, rliable: the interquartile mean (25 % trimmed from each side), percentile intervals of a stratified bootstrap,
the probability of improvement, and score distributions as performance profiles.

The library itself is not used. Its version 1.2.0 asks for arch below 8, whose 7.2 does not import beside statsmodels
0.15; with arch 8 its `get_interval_estimates` raises TypeError; and it draws from NumPy's global state whatever
`random_state` it is given, so that no report would come out the same twice. It would also bring 170 MB of packages.
A report has one task, so the strata are the groups: each is resampled by itself, to its own size. Every bootstrap
begins with the same seed, so that a figure does not depend on what else is in the report.

Shapes: `N`, `M` runs of a group, `T` points of a curve, `B` resamples.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.evaluation.results import styles_of
from carrl.report.runs import RunResult

Value = Callable[[RunResult], float | None]


@dataclass(frozen=True)
class Measure:
    """A figure of a run.

    Attributes:
        key: its name in tables for machines, with its unit.
        name: its name for readers.
        more_is_better: whether a larger value is.
        better: what the better of two groups does: "laps after fewer frames".
        form: how a value is written.
        value: of a run that has finished; None where it has none, infinite where it never came.
        limit: what a run counts with in means where its value is infinite: as far as it went.
        scale: parts of the configuration on which its scale depends.
        by_the_clock: whether it is a time, which seeds trained at once share: for them it is one sample, not many.
    """

    key: str
    name: str
    more_is_better: bool
    better: str
    form: str
    value: Value
    limit: Value = lambda run: None
    scale: tuple[str, ...] = ()
    by_the_clock: bool = False

    def is_on_one_scale(self, runs: Iterable[RunResult]) -> bool:
        """Whether the runs' configurations make their values comparable."""
        return len({repr([_part(run.config, key) for key in self.scale]) for run in runs}) < 2

    def write(self, value: float) -> str:
        """A value in words."""
        return "never" if math.isinf(value) else f"{value:{self.form}}"


def _part(config: Any, key: str) -> Any:
    """What the configuration has at a dotted key; None for nothing."""
    for name in key.split("."):
        config = config.get(name) if isinstance(config, dict) else None
    return config


def _summary(run: RunResult) -> dict[str, Any]:
    return run.summary or {}


def _of_first_lap(key: str) -> Value:
    def value(run: RunResult) -> float | None:
        if run.learnt_from_logs:
            return None  # it is driven once, at the end
        first_lap = _summary(run).get("first_lap")
        return math.inf if first_lap is None else float(first_lap[key])

    return value


def _of_best_drive(key: str, of_laps_only: bool = False) -> Value:
    def value(run: RunResult) -> float | None:
        drive = _summary(run).get("evaluation")
        if drive is None or drive.get(key) is None or (of_laps_only and not drive["lap_completed"]):
            return None
        return float(drive[key])

    return value


def _final_return(run: RunResult) -> float | None:
    return run.ends.mean_returns[-1] if run.ends.mean_returns else None


FIRST_LAP_FRAMES = Measure(
    key="first_lap_frames",
    name="first lap, frames",
    more_is_better=False,
    better="laps after fewer frames",
    form=",.0f",
    value=_of_first_lap("frame"),
    limit=lambda run: float(_summary(run)["frames"]),
)
FIRST_LAP_SECONDS = Measure(
    key="first_lap_s",
    name="first lap, s",
    more_is_better=False,
    better="laps after less time",
    form=",.1f",
    value=_of_first_lap("wall_time_s"),
    limit=lambda run: float(_summary(run)["wall_time_s"]),
    by_the_clock=True,
)
PROGRESS = Measure("progress", "progress", True, "gets farther in its best drive", ".0%", _of_best_drive("progress"))
LAP_REWARD = Measure(
    key="lap_reward",
    name="lap reward",
    more_is_better=True,
    better="has the greater reward in its best drive",
    form=",.0f",
    value=_of_best_drive("lap_reward"),
    scale=(
        "track",
        "reward.collision.weight",
        "reward.proximity.weight",
        "reward.gate.weight",
    ),  # the paper's rewards; turns cost nothing here
)
FINAL_RETURN = Measure(
    key="final_return",
    name="return, last 20 episodes",
    more_is_better=True,
    better="has the greater final return",
    form=",.0f",
    value=_final_return,
    scale=("track", "reward"),
)
SWITCHES = Measure(
    "switches_per_100m",
    "switches / 100 m",
    False,
    "switches less often",
    ".1f",
    _of_best_drive("switches_per_100m", of_laps_only=True),
)
FORWARD_SHARE = Measure(
    "forward_share",
    "forward share",
    True,
    "drives forward more",
    ".1%",
    _of_best_drive("forward_share", of_laps_only=True),
)
MEAN_SPEED = Measure(
    "mean_speed",
    "mean speed, m/s",
    True,
    "drives faster",
    ".1f",
    _of_best_drive("mean_speed", of_laps_only=True),
)
LAP_TIME = Measure(
    key="lap_time",
    name="lap time, s",
    more_is_better=False,
    better="laps faster",
    form=".2f",
    value=_of_best_drive("lap_time", of_laps_only=True),
    scale=("track", "evaluation.starts"),
)
STEERING_CHANGE = Measure(
    "steering_change",
    "steering change",
    False,
    "steers more calmly",
    ".3f",
    _of_best_drive("steering_change", of_laps_only=True),
)
MEASURES = (
    *(FIRST_LAP_FRAMES, FIRST_LAP_SECONDS, PROGRESS, LAP_REWARD, FINAL_RETURN, SWITCHES, FORWARD_SHARE),
    *(LAP_TIME, MEAN_SPEED, STEERING_CHANGE),
)
STYLES = (SWITCHES, FORWARD_SHARE, LAP_TIME, MEAN_SPEED, STEERING_CHANGE)
"""Those that only some kinds of cars and of actions have, or that older versions did not measure."""


def measures_of(runs: Iterable[RunResult]) -> list[Measure]:
    """Those that runs of these cars and actions may have."""
    drives = [_summary(run).get("evaluation") or {} for run in runs]
    styles = {style.key for style in styles_of(drives)}
    return [measure for measure in MEASURES if measure not in STYLES or measure.key in styles]


RESAMPLES, CURVE_RESAMPLES = 10_000, 2_000
"""Of single figures, and of curves, which have many points."""
CONFIDENCE = 0.95
SEED = 0
"""Of every bootstrap."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A figure with its interval.

    Attributes:
        value: the figure.
        low: lower end of its 95 % interval; nan where a group has a single run, which has no spread.
        high: upper end.
    """

    value: float
    low: float
    high: float

    @property
    def complement(self) -> "Estimate":
        """Of a probability, that of the opposite."""
        return Estimate(1 - self.value, 1 - self.high, 1 - self.low)


@dataclass(frozen=True)
class Band:
    """A curve with its interval at each point, [T] each; as in `Estimate`."""

    value: Floats
    low: Floats
    high: Floats


def iqm(scores: Floats) -> Floats:
    """The mean without the lowest and the highest quarter, rounded down, over the first axis: [N, ...] to [...]."""
    cut = len(scores) // 4
    mean: Floats = np.sort(scores, axis=0)[cut : len(scores) - cut].mean(axis=0)
    return mean


def iqm_estimate(scores: Sequence[float]) -> Estimate:
    """The interquartile mean of [N] scores, N at least 1."""
    values = np.asarray(scores, dtype=np.float64)
    if len(values) == 1:
        return Estimate(float(values[0]), math.nan, math.nan)
    return _estimate(float(iqm(values)), iqm(values[_resampled(len(values), RESAMPLES)].T))


def iqm_band(curves: Floats) -> Band:
    """The interquartile mean at each point of the curves [N, T], whole runs resampled."""
    drawn = _resampled(len(curves), CURVE_RESAMPLES)
    return _band(iqm(curves), np.stack([iqm(points[drawn].T) for points in curves.T], axis=1))


def share_band(hits: NDArray[np.bool_]) -> Band:
    """The share of runs that have hit at each point, [N, T]."""
    times = _times_drawn(len(hits), CURVE_RESAMPLES, np.random.default_rng(SEED))
    return _band(hits.mean(axis=0), times @ hits / len(hits))


def improvement(better: Sequence[float], worse: Sequence[float]) -> Estimate:
    """The probability that a run of the first group has a greater score than one of the second, ties counted half.

    Source: Agarwal et al. (2021), section 4.3; the Mann-Whitney U statistic over N M.
    """
    wins = _wins(np.asarray(better, dtype=np.float64), np.asarray(worse, dtype=np.float64))
    if min(wins.shape) == 1:
        return Estimate(float(wins.mean()), math.nan, math.nan)
    generator = np.random.default_rng(SEED)
    first, second = (_times_drawn(count, RESAMPLES, generator) for count in wins.shape)
    return _estimate(float(wins.mean()), np.einsum("bn,nm,bm->b", first, wins, second, optimize=True) / wins.size)


def p_value(first: Sequence[float], second: Sequence[float]) -> float:
    """Two-sided p of the Mann-Whitney test, exact even with ties, which first laps have, as they fall on evaluations.

    It is the share of all ways to divide the runs between two such groups in which the sum of a group's ranks is as far
    from what it would be on average. Ways are counted by the sum of ranks, run by run, instead of being listed.
    """
    ranks = np.rint(2 * _mid_ranks(np.array([*first, *second], dtype=np.float64))).astype(int)  # whole, as doubled
    chosen = ranks[: len(first)] if len(first) <= len(second) else ranks[len(first) :]
    size, total = len(chosen), int(ranks.sum())
    ways = np.zeros((size + 1, total + 1))  # so many of the runs so far, so large a sum
    ways[0, 0] = 1
    for rank in ranks:
        ways[1:, rank:] += ways[:-1, : total + 1 - rank]
    distances = np.abs(len(ranks) * np.arange(total + 1) - size * total)  # from the average sum, in whole numbers
    extreme = distances >= distances[chosen.sum()]
    return float(ways[size, extreme].sum() / ways[size].sum())


def holm(p_values: Sequence[float]) -> list[float]:
    """The p-values of one family of tests, corrected for their number.

    Source: Holm (1979), A Simple Sequentially Rejective Multiple Test Procedure.
    """
    corrected, largest = [0.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = largest
    return corrected


def least_p(first: int, second: int) -> float:
    """The least p that groups of so many runs can reach: all of one better than all of the other."""
    return min(1.0, 2 / math.comb(first + second, first))


def _mid_ranks(scores: Floats) -> Floats:
    """Ranks from 1 on, [N]; scores that tie share the mean of theirs. Infinite ones are the last, or first."""
    _, places, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks: Floats = (counts.cumsum() - (counts - 1) / 2)[places]
    return ranks


def _wins(first: Floats, second: Floats) -> Floats:
    """1 where a run of the first [N] beats one of the second [M], 0.5 where they tie, [N, M]."""
    own, other = first[:, None], second[None, :]
    return (own > other) + 0.5 * (own == other)


def _resampled(count: int, resamples: int) -> NDArray[np.int64]:
    """Numbers of runs drawn with replacement, [B, N]."""
    return np.random.default_rng(SEED).integers(count, size=(resamples, count))


def _times_drawn(count: int, resamples: int, generator: np.random.Generator) -> Floats:
    """How often each run is drawn in each resample, [B, N]."""
    return generator.multinomial(count, [1 / count] * count, size=resamples).astype(np.float64)


def _estimate(value: float, drawn: Floats) -> Estimate:
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return Estimate(value, float(low), float(high))


def _band(value: Floats, drawn: Floats) -> Band:
    """The band of a curve [T] from its resamples [B, T]."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0)
    return Band(value, low, high)
