"""What is missing, corrupt or duplicated among the runs of a report: named, so that nobody has to notice."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice, product
from math import prod
from pathlib import Path

from carrl.errors import CarrlError, CheckpointError
from carrl.report.groups import ONLY_GROUP, OVERRIDES, Group
from carrl.report.runs import RunResult
from carrl.train.files import read_yaml

SWEEP = "multirun.yaml"
"""Hydra's note of the whole sweep, in its folder."""
MOST_JOBS = 2**16
"""That a sweep may have."""
DUPLICATE, MISSING, DAMAGED_SWEEP = "duplicate", "missing", "damaged"


def find_sweeps(roots: Sequence[Path]) -> list[Path]:
    """The folders of all multiruns below these, in the order of their paths."""
    return sorted({path.parent for root in roots for path in root.rglob(SWEEP)})


def missing_jobs(sweep: Path) -> Iterator[str]:
    """The overrides of every job that has left no folder, as in "loss=cql seed=3".

    Raises:
        CheckpointError: what the sweep was to be cannot be read.
    """
    overrides = _read_list(sweep / SWEEP, "hydra", "overrides", "task")
    started = [set(_read_list(path)) for path in sweep.rglob(str(OVERRIDES))]
    for job in _jobs(overrides):
        if set(job) not in started:
            yield " ".join(job)


def _read_list(path: Path, *keys: str) -> list[str]:
    """The list of texts at these keys of a YAML file."""
    try:
        found = read_yaml(path)
        for key in keys:
            found = found[key]
    except (CarrlError, KeyError, TypeError) as error:
        raise CheckpointError(f"'{path}' is damaged: it lists no overrides") from error
    if not isinstance(found, list) or not all(isinstance(entry, str) for entry in found):
        raise CheckpointError(f"'{path}' is damaged: it lists no overrides")
    return found


def _jobs(overrides: list[str]) -> Iterator[tuple[str, ...]]:
    """The overrides of each job, as Hydra 1.3's basic sweeper makes them."""
    from hydra.core.override_parser.overrides_parser import OverridesParser  # slow, and only multiruns need it
    from hydra.core.override_parser.types import RangeSweep
    from hydra.errors import HydraException

    choices: dict[str, list[str]] = {}
    try:
        for override in OverridesParser.create().parse_overrides(overrides):
            key = override.get_key_element()
            if override.is_sweep_override():
                if isinstance(values := override.value(), RangeSweep):
                    values.shuffle = False  # for which Hydra would make a list of them all
                choices[key] = [f"{key}={value}" for value in islice(override.sweep_string_iterator(), MOST_JOBS + 1)]
            else:
                choices[key] = [f"{key}={override.get_value_element_as_str()}"]
    except HydraException as error:
        raise CheckpointError(f"its overrides cannot be read: {error}") from error
    if prod(map(len, choices.values())) > MOST_JOBS:
        raise CheckpointError(f"it has more than {MOST_JOBS} jobs, which are not looked for one by one")
    return product(*choices.values())


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
