"""All that a report tells of some runs: which of two groups is better by a measure, and how sure that is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from carrl.errors import ConfigError
from carrl.report.groups import Group, Problem, find_problems, group_runs
from carrl.report.measures import MEASURES, Estimate, Measure, holm, improvement, iqm_estimate, least_p, p_value
from carrl.report.runs import RunResult, find_runs

MOST_PAIRS = 15
"""Of more groups than make so many pairs, each is compared with the baseline alone."""
SIGNIFICANCE = 0.05
FEWEST_RUNS = 2
"""Of a group that is compared."""

Pair = tuple[Group, Group]


@dataclass(frozen=True)
class Comparison:
    """Two groups by one measure.

    Attributes:
        measure: by which.
        first: label of the group that is better, or as good.
        second: label of the other.
        runs: of both that have the measure.
        probability: that a run of the first is better than one of the second.
        p: of the two-sided Mann-Whitney test.
        corrected_p: the same by Holm's method, for all pairs compared by this measure.
    """

    measure: Measure
    first: str
    second: str
    runs: tuple[int, int]
    probability: Estimate
    p: float
    corrected_p: float

    @property
    def significant(self) -> bool:
        """Whether the interval excludes one half and the corrected p is below 0.05.

        Both, since the bootstrap's interval is too narrow for few runs: of two against two it can be [1, 1].
        """
        return self.probability.low > 0.5 and self.corrected_p < SIGNIFICANCE

    def __str__(self) -> str:
        """One sentence."""
        chance = self.probability
        return (
            f"{self.first} {self.measure.better} than {self.second} (probability of improvement {chance.value:.2f} "
            f"[{chance.low:.2f}, {chance.high:.2f}], {_equation(self.corrected_p)})"
        )


def written_p(p: float) -> str:
    """A p-value with two digits that count."""
    return "1" if p >= 0.995 else "< 0.0001" if p < 1e-4 else f"{p:.2g}"


def pairs_to_compare(groups: Sequence[Group], baseline: str | None = None) -> list[Pair]:
    """Pairs of groups that differ in one choice, since others confound two; all pairs where there is no such.

    Of too many pairs, or where a baseline is named, those with the baseline, which is the first group unless named.

    Raises:
        ConfigError: no group has the baseline's label.
    """
    labels = [group.label for group in groups]
    if baseline is not None and baseline not in labels:
        raise ConfigError(f"no group is '{baseline}'; choose a baseline of: {'; '.join(labels)}")
    pairs = [pair for pair in combinations(groups, 2) if _differ_in_one(*pair)] or list(combinations(groups, 2))
    if baseline is None and len(pairs) <= MOST_PAIRS:
        return pairs
    first = groups[labels.index(baseline) if baseline is not None else 0]
    return [(first, other) for other in groups if other is not first]


def compare(pairs: Sequence[Pair]) -> list[Comparison]:
    """The pairs by every measure that enough runs of both have.

    Rewards are left out where they are not on one scale. Times are left out for seeds that were trained at once: they
    wait for the same compilation and the same machine, so that two processes would be compared as if they were many.
    """
    return [comparison for measure in MEASURES for comparison in _by(measure, pairs)]


def runs_needed(pairs: Sequence[Pair]) -> int | None:
    """How many runs a group needs for any difference to be significant; None where that is possible as it is."""
    if not pairs or any(
        len(pairs) * least_p(len(first.counted), len(second.counted)) < SIGNIFICANCE for first, second in pairs
    ):
        return None
    count = FEWEST_RUNS
    while len(pairs) * least_p(count, count) >= SIGNIFICANCE:
        count += 1
    return count


def values_of(group: Group, measure: Measure) -> list[float]:
    """Of the group's runs that count and have one."""
    return [value for value in map(measure.value, group.counted) if value is not None]


def _equation(p: float) -> str:
    return f"p {written_p(p)}" if p < 1e-4 else f"p = {written_p(p)}"


def _differ_in_one(first: Group, second: Group) -> bool:
    return sum(first.differs[key] != second.differs[key] for key in first.differs) == 1


def _can_compare(measure: Measure, pair: Pair) -> bool:
    if min(len(values_of(group, measure)) for group in pair) < FEWEST_RUNS:
        return False
    runs = [run for group in pair for run in group.counted]
    return measure.is_on_one_scale(runs) and not (measure.by_the_clock and any(run.trained_with_others for run in runs))


def _by(measure: Measure, pairs: Sequence[Pair]) -> list[Comparison]:
    """The pairs by one measure, the better group first."""
    sign = 1 if measure.more_is_better else -1
    sides = [[[sign * value for value in values_of(group, measure)] for group in pair] for pair in pairs]
    enough = [index for index, pair in enumerate(pairs) if _can_compare(measure, pair)]
    p_values = [p_value(*sides[index]) for index in enough]
    comparisons = []
    for index, p, corrected in zip(enough, p_values, holm(p_values), strict=True):
        chance, (first, second) = improvement(*sides[index]), pairs[index]
        runs = (len(sides[index][0]), len(sides[index][1]))
        if chance.value < 0.5:
            chance, first, second, runs = chance.complement, second, first, runs[::-1]
        comparisons.append(Comparison(measure, first.label, second.label, runs, chance, p, corrected))
    return comparisons


@dataclass(frozen=True)
class GroupFigure:
    """A measure of a group.

    Attributes:
        estimate: its interquartile mean.
        runs: how many have it.
        never: how many of these count with their limit, so that the mean is at least what it says.
    """

    estimate: Estimate
    runs: int
    never: int


@dataclass(frozen=True)
class Findings:
    """Runs, their groups, and what comes of comparing them.

    Attributes:
        runs: all, in the natural order of their paths.
        groups: in the order in which they were asked for.
        figures: of each group, by the key of the measure; where no run has it, there is none.
        problems: what is missing, broken or there twice.
        comparisons: of pairs of groups, by measure.
        runs_needed: how many runs a group needs for any difference to be significant; None where that is possible.
    """

    runs: list[RunResult]
    groups: list[Group]
    figures: list[dict[str, GroupFigure]]
    problems: list[Problem]
    comparisons: list[Comparison]
    runs_needed: int | None

    @property
    def significant(self) -> list[Comparison]:
        """The comparisons that show a difference."""
        return [comparison for comparison in self.comparisons if comparison.significant]


def find(roots: list[Path], baseline: str | None = None) -> Findings:
    """All that can be told of the runs below these folders.

    Args:
        roots: folders of runs, or runs.
        baseline: label of the group to compare the others with; None for all pairs, or if they are many for the first.

    Raises:
        CheckpointError: there is no run.
        ConfigError: there is no such baseline.
    """
    runs = find_runs(roots)
    groups = group_runs(runs, roots)
    pairs = pairs_to_compare(groups, baseline)
    problems = find_problems(runs, groups, roots)
    return Findings(runs, groups, _figures(groups), problems, compare(pairs), runs_needed(pairs))


def lapped(group: Group) -> int:
    """How many of the group's runs have lapped."""
    drives = [(run.summary or {}).get("evaluation") for run in group.counted]
    return sum(bool(drive and drive["lap_completed"]) for drive in drives)


def _figures(groups: Sequence[Group]) -> list[dict[str, GroupFigure]]:
    return [
        {measure.key: _figure(group, measure) for measure in MEASURES if values_of(group, measure)} for group in groups
    ]


def _figure(group: Group, measure: Measure) -> GroupFigure:
    values = [(measure.value(run), measure.limit(run)) for run in group.counted]
    reached = [limit if value == math.inf else value for value, limit in values if value is not None]
    scores = [score for score in reached if score is not None]
    return GroupFigure(iqm_estimate(scores), len(scores), sum(value == math.inf for value, _ in values))
