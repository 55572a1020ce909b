"""What runs were asked to be, the runs that differ in nothing but their seed, and what tells such groups apart."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import islice, product
from math import prod
from pathlib import Path
from typing import Any

from carrl.errors import CarrlError, CheckpointError
from carrl.report.runs import RunResult, in_natural_order
from carrl.train.files import read_config, read_yaml
from carrl.train.plan import TrainingPlan

OVERRIDES, HYDRA = Path(".hydra/overrides.yaml"), Path(".hydra/hydra.yaml")
WITHIN_GROUP = ("seed", "trainer.seeds", "resume")
"""What may differ within a group."""
ONLY_GROUP = "all runs"
"""The name of a group that is the only one."""


@dataclass(frozen=True)
class Choices:
    """How a run was asked for.

    Attributes:
        values: the resolved configuration but for the seed: `loss.gamma` to "0.95".
        options: the option chosen of each group of `conf/`: `loss` to "double_dqn"; empty where nothing tells.
        typed: the keys of the overrides on the command line, but for the seed.
        job: its number in a multirun.
    """

    values: Mapping[str, str] = field(repr=False)
    options: Mapping[str, str] = field(repr=False)
    typed: tuple[str, ...]
    job: int

    def value_of(self, key: str) -> str:
        """What the run has for a key of the configuration, or for a group of `conf/`; "-" for nothing."""
        return self.options.get(key, self.values.get(key, "-"))


def read_choices(run: RunResult) -> Choices:
    """What the run was asked to be.

    Hydra's own files stand in the folder of the run, or in the one above, where several seeds were trained at once.
    What is missing or damaged there only makes names longer, and is passed over.
    """
    values = {key: value for key, value in flat(run.config).items() if key not in WITHIN_GROUP}
    hydra, overrides = _first(run, HYDRA), _first(run, OVERRIDES)
    options = {key: as_typed(value) for key, value in _at(hydra, "hydra", "runtime", "choices").items()}
    options = {key: option for key, option in options.items() if "/" not in str(key)}  # Hydra's own
    job = _at(hydra, "hydra", "job").get("num")
    typed = [override_key(each) for each in overrides if isinstance(each, str)] if isinstance(overrides, list) else []
    typed = [key for key in dict.fromkeys(typed) if key and key not in WITHIN_GROUP and not key.startswith("hydra")]
    return Choices(values, options, tuple(typed), job if isinstance(job, int) else 0)


def override_key(override: str) -> str:
    """The key of an override: `loss` of `loss=cql`, `+a.b` is `a.b`."""
    return override.partition("=")[0].lstrip("+~").partition("@")[0]


def flat(config: Any, above: str = "") -> dict[str, str]:
    """A nested configuration as dotted keys to values as they are typed."""
    if not isinstance(config, dict) or not config:
        return {above: as_typed(config)} if above else {}
    leaves: dict[str, str] = {}
    for key, value in config.items():
        leaves |= flat(value, f"{above}.{key}" if above else str(key))
    return leaves


def as_typed(value: Any) -> str:
    """A value as it is typed: true, null, 0.5, [16,16,8], paper."""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"), default=str)


def _first(run: RunResult, path: Path) -> Any:
    """What the file holds that stands in the run's folder, or else in the one above; None if in neither."""
    found = (_read(folder / path) for folder in (run.folder, run.folder.parent))
    return next((each for each in found if each), None)


def _read(path: Path) -> Any:
    try:
        return read_yaml(path) if path.exists() else None
    except CarrlError:
        return None


def _at(tree: Any, *keys: str) -> dict[str, Any]:
    """The mapping at these keys; empty where there is none."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree if isinstance(tree, dict) else {}


@dataclass(frozen=True)
class Group:
    """Runs with the same configuration but for the seed.

    Attributes:
        label: what tells it from the other groups: "loss=cql".
        differs: the same as keys and values; empty if it is the only group.
        runs: all of them, in the order of their seeds.
        planned: the seeds that it was to be trained with, as far as its folders tell.
    """

    label: str
    differs: dict[str, str]
    runs: tuple[RunResult, ...]
    planned: tuple[int, ...] = field(default=(), repr=False)

    @property
    def counted(self) -> tuple[RunResult, ...]:
        """The runs that have finished, one for each seed, the first where there are several."""
        return tuple({run.seed: run for run in reversed(self.runs) if run.counts}.values())[::-1]

    @property
    def seeds(self) -> list[int]:
        """Of the runs that count."""
        return [run.seed for run in self.counted if run.seed is not None]


def group_runs(runs: Sequence[RunResult], roots: Sequence[Path] = ()) -> list[Group]:
    """The groups, in the order in which they were asked for: by root, then by number in the multirun, then by path.

    Runs whose configuration cannot be read are in none.
    """
    members: dict[tuple[tuple[str, str], ...], list[tuple[RunResult, Choices]]] = {}
    for run in runs:
        if run.config:
            choices = read_choices(run)
            members.setdefault(tuple(sorted(choices.values.items())), []).append((run, choices))
    ordered = sorted(members.values(), key=lambda pairs: min(_place(run, choices, roots) for run, choices in pairs))
    labels = _differences([pairs[0][1] for pairs in ordered])
    return [_group(differs, [run for run, _ in pairs]) for differs, pairs in zip(labels, ordered, strict=True)]


def _group(differs: dict[str, str], runs: list[RunResult]) -> Group:
    label = ", ".join(f"{key}={value}" for key, value in differs.items()) or ONLY_GROUP
    runs = sorted(runs, key=lambda run: (-1 if run.seed is None else run.seed, in_natural_order(run.folder)))
    return Group(label, differs, tuple(runs), tuple(sorted(_planned_seeds(runs))))


def _place(run: RunResult, choices: Choices, roots: Sequence[Path]) -> tuple[int, int, list[tuple[str, int]]]:
    root = next((index for index, root in enumerate(roots) if run.folder.is_relative_to(root)), len(roots))
    return root, choices.job, in_natural_order(run.folder)


def _planned_seeds(runs: Sequence[RunResult]) -> set[int]:
    """The seeds that the runs' own configurations name, and those of the folders above, for seeds trained at once."""
    configs = [run.config for run in runs]
    for folder in {run.folder.parent for run in runs if run.trained_with_others}:
        with suppress(CarrlError):
            configs.append(read_config(folder))
    seeds: set[int] = set()
    for config in configs:
        with suppress(CarrlError, TypeError, AttributeError):  # written by hand; the run itself would have been refused
            named = (config.get("trainer") or {}).get("seeds")
            seeds.update(TrainingPlan(1, 1, seeds=named).replicate_seeds(config["seed"]))
    return seeds


def _differences(groups: Sequence[Choices]) -> list[dict[str, str]]:
    """What tells each group from the others: the overrides that were typed, and more where that is not enough."""
    if len(groups) < 2:
        return [{} for _ in groups]
    keys = [key for key in dict.fromkeys(key for each in groups for key in each.typed) if _varies(key, groups)]
    keys = [key for key in keys if not any(_says_more(other, key, groups) for other in keys)]
    for key in _from_plain_to_odd(groups):
        if len(_told_apart(keys, groups)) == len(groups):
            break
        if len(_told_apart([*keys, key], groups)) > len(_told_apart(keys, groups)):
            keys.append(key)
    return [_shortened({key: each.value_of(key) for key in keys}) for each in groups]


def _from_plain_to_odd(groups: Sequence[Choices]) -> list[str]:
    """All keys of the configurations: first those that every group has, last the names of functions."""
    keys = {key for each in groups for key in each.values}
    return sorted(keys, key=lambda key: ("._" in key, not all(key in each.values for each in groups), key))


def _varies(key: str, groups: Sequence[Choices]) -> bool:
    return len({each.value_of(key) for each in groups}) > 1


def _told_apart(keys: Sequence[str], groups: Sequence[Choices]) -> set[tuple[str, ...]]:
    return {tuple(each.value_of(key) for key in keys) for each in groups}


def _says_more(key: str, general: str, groups: Sequence[Choices]) -> bool:
    """Whether a key below `general` tells all that this tells: `track.name_or_path` where `track` is `file`."""
    both = _told_apart([key, general], groups)
    return key.startswith(f"{general}.") and len(both) == len(_told_apart([key], groups))


def _shortened(differs: dict[str, str]) -> dict[str, str]:
    """Of paths the last part."""
    return {key: Path(value).name if value.startswith("/") else value for key, value in differs.items()}


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
