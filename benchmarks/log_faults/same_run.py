"""Whether two runs' folders tell of the same training, bit for bit but for wall time."""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from benchmarks.log_faults.contents import LogContents, read_contents
from benchmarks.log_faults.kill import common_entries
from carrl.log import verify
from carrl.train.checkpoint import STATE, load_checkpoint
from carrl.train.files import EVALUATIONS, LOG, METRICS, SUMMARY

_WALL_TIME = {"wall_time_s", "first_update_s", "start_up_s"}
_OF_WALL_TIME = {"log", "tables"}
"""Parts of a state: how far the log is, whose size tells of wall time as its metrics do, and the tables' text."""

_OF_HYDRA = {"hydra.yaml", "overrides.yaml"}
"""Hydra's records of how a run was asked for, written before all else; a kill may come before them."""
_NAMED = 2
"""How many of the differing values are named."""


@dataclass(frozen=True)
class RunContents:
    """What a run's folder says, but for wall time.

    Attributes:
        state: of the latest checkpoint to resume from, tensors as bytes, by path within it.
        networks: the bytes of best.pt and last.pt.
        tables: the rows of each.
        log: what it says.
        summary: all of it.
        files: names of all that is there but Hydra's own records.
    """

    state: dict[str, Any]
    networks: dict[str, bytes]
    tables: dict[str, list[dict[str, str]]]
    log: LogContents
    summary: dict[str, Any]
    files: set[str]


def read_run(run: Path) -> RunContents:
    """Reads a run that has ended.

    Raises:
        CarrlError, OSError: it has not, or something is damaged.
    """
    verify(run / LOG)
    return RunContents(
        state=dict(_flat(load_checkpoint(run / STATE), "")),
        networks={name: (run / "checkpoints" / name).read_bytes() for name in ("best.pt", "last.pt")},
        tables={name: _rows(run / name) for name in (METRICS, EVALUATIONS)},
        log=read_contents(run / LOG),
        summary=_without_wall_time(json.loads((run / SUMMARY).read_text())),
        files={str(path.relative_to(run)) for path in run.rglob("*") if path.is_file() and path.name not in _OF_HYDRA},
    )


def differences(ours: RunContents, theirs: RunContents) -> Iterator[str]:
    """Sentences on what the one says otherwise than the other, a run that nobody killed."""
    if not ours.summary["finished"]:
        yield f"{SUMMARY} says that the run is not finished"
    changed = sorted(key for key in ours.state.keys() | theirs.state.keys() if _differs(key, ours, theirs))
    parameters = [key for key in changed if key.startswith("learner.")]
    if parameters:
        yield f"the final parameters are others, in {_some(parameters)}"
    if changed != parameters:
        yield f"{STATE} is another one in {_some([key for key in changed if key not in parameters])}"
    for name, own, other in (
        *((name, content, theirs.networks[name]) for name, content in ours.networks.items()),
        *((name, rows, theirs.tables[name]) for name, rows in ours.tables.items()),
        ("the log's transitions", ours.log.rows, theirs.log.rows),
        ("the log's episodes", ours.log.episodes, theirs.log.episodes),
        ("the log's attachments", ours.log.attachments, theirs.log.attachments),
        ("the log's metadata", common_entries(ours.log), common_entries(theirs.log)),
        (SUMMARY, ours.summary, theirs.summary),
    ):
        if own != other:
            yield f"{name}: not those of the run that nobody killed"
    if ours.files != theirs.files:
        yield f"files left over or missing: {', '.join(sorted(ours.files ^ theirs.files))}"


def _some(keys: Sequence[str]) -> str:
    return ", ".join(keys[:_NAMED]) + (f" and {len(keys) - _NAMED} others" if len(keys) > _NAMED else "")


def _differs(key: str, ours: RunContents, theirs: RunContents) -> bool:
    return ours.state.get(key, "missing") != theirs.state.get(key, "missing")


def _flat(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """The values in a nested state in a form that is equal only if every bit is, by path."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key not in _WALL_TIME | _OF_WALL_TIME:
                yield from _flat(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _flat(item, f"{path}.{index}")
    elif isinstance(value, Tensor):
        yield path, (str(value.dtype), tuple(value.shape), value.contiguous().numpy().tobytes())
    else:
        yield path, repr(value)  # in which a NaN equals itself


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [_without_wall_time(row) for row in csv.DictReader(file)]


def _without_wall_time(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: _without_wall_time(value) for key, value in values.items() if key not in _WALL_TIME}
    return values
