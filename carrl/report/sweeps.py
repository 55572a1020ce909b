"""What a multirun was to train, and which of its jobs have left no folder."""

from collections.abc import Iterator, Sequence
from itertools import islice, product
from math import prod
from pathlib import Path

from carrl.errors import CarrlError, CheckpointError
from carrl.report.choices import OVERRIDES
from carrl.train.files import read_yaml

SWEEP = "multirun.yaml"
"""Hydra's note of the whole sweep, in its folder."""
MOST_JOBS = 2**16
"""That a sweep may have."""


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
