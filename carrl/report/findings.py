"""All that a report tells of some runs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from carrl.report.comparison import Comparison, compare, pairs_to_compare, runs_needed, values_of
from carrl.report.groups import Group, group_runs
from carrl.report.measures import MEASURES, Measure
from carrl.report.problems import Problem, find_problems
from carrl.report.reading import RunResult
from carrl.report.runs import find_runs
from carrl.report.statistics import Estimate, iqm_estimate


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
