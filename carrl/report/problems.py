"""What is missing, broken, or there twice among the runs of a report: named, so that nobody has to notice."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from carrl.errors import CarrlError
from carrl.report.groups import ONLY_GROUP, Group
from carrl.report.reading import RunResult
from carrl.report.sweeps import find_sweeps, missing_jobs

DUPLICATE, MISSING, DAMAGED_SWEEP = "duplicate", "missing", "damaged"


@dataclass(frozen=True)
class Problem:
    """Something that keeps a run out of the comparison.

    Attributes:
        kind: "unfinished", "interrupted", "damaged", "duplicate" or "missing".
        what: the run, the group or the sweep.
        reason: in words.
    """

    kind: str
    what: str
    reason: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.kind}: {self.what}: {self.reason}"

    def as_dict(self) -> dict[str, str]:
        """Ready for JSON."""
        return asdict(self)


def find_problems(runs: Sequence[RunResult], groups: Sequence[Group], roots: Sequence[Path] = ()) -> list[Problem]:
    """All problems: of single runs first, then of groups, then of sweeps."""
    return [*_of_runs(runs), *_duplicates(groups), *_missing_seeds(groups), *_of_sweeps(roots)]


def _of_runs(runs: Sequence[RunResult]) -> Iterator[Problem]:
    for run in runs:
        if not run.counts:
            yield Problem(run.state, run.label, f"{run.reason}; not counted")


def _duplicates(groups: Sequence[Group]) -> Iterator[Problem]:
    for group in groups:
        counted = {run.seed: run for run in group.counted}
        for run in group.runs:
            first = counted.get(run.seed)
            if run.counts and first is not None and run is not first:
                reason = f"the same configuration and seed as {first.label}, which is counted instead"
                yield Problem(DUPLICATE, run.label, reason)


def _missing_seeds(groups: Sequence[Group]) -> Iterator[Problem]:
    """Seeds that other groups have, or that the group itself was to have, and of which there is no trace in it."""
    everywhere = {run.seed for group in groups for run in group.runs} - {None}
    for group in groups:
        present = {run.seed for run in group.runs}
        lacking = sorted(seed for seed in everywhere | set(group.planned) if seed is not None and seed not in present)
        if lacking:
            what = "the runs" if group.label == ONLY_GROUP else group.label
            yield Problem(MISSING, what, f"no run with seed {', '.join(map(str, lacking))}")


def _of_sweeps(roots: Sequence[Path]) -> Iterator[Problem]:
    for sweep in find_sweeps(roots):
        try:
            jobs = list(missing_jobs(sweep))
        except CarrlError as error:
            yield Problem(DAMAGED_SWEEP, str(sweep), f"{error}; jobs that never began are not named")
            continue
        for job in jobs:
            yield Problem(MISSING, str(sweep), f"the job {job} has left no folder")
