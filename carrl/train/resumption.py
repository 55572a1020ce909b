"""What a run that is resumed goes on with: its own configuration, but for what may be changed."""

import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from carrl.config import is_whole_number
from carrl.errors import CheckpointError, ConfigError, shown
from carrl.train.checkpoint import PREVIOUS, STATE, load_state
from carrl.train.files import (
    CONFIG,
    EVALUATIONS,
    LAP,
    LEARNING_CURVE,
    METRICS,
    SUMMARY,
    load_config,
    seed_folders,
)
from carrl.train.learner import DIVERGENCE

CHANGEABLE = (
    "trainer.frames",
    "trainer.episodes",
    "trainer.checkpoint_interval",
    "data.updates",
    "evaluation.interval",
    "optimizer.lr",
    "collector.workers",
    "collector.address",
)
"""What may be given anew: how long, how often, how large the steps are, and which cluster drives."""
_IN_THE_SIMULATOR = (
    "trainer.frames",
    "trainer.episodes",
    "evaluation.interval",
    "collector.workers",
    "collector.address",
)
"""What a run that learns from logs does not read."""
_FILES = (
    METRICS,
    EVALUATIONS,
    SUMMARY,
    LEARNING_CURVE,
    LAP,
    DIVERGENCE,
    STATE,
    PREVIOUS,
    "checkpoints/best.pt",
    "checkpoints/last.pt",
    str(CONFIG),
    str(CONFIG.with_name("hydra.yaml")),
    str(CONFIG.with_name("overrides.yaml")),
)
"""What is written in the folder of a run or of one of its seeds; a log that is none goes on in another file."""
_HAS_LINKS = "wandb"
"""A logger's own folder, in which it keeps links to its latest files."""


@dataclass(frozen=True)
class Resumption:
    """A run to go on with.

    Attributes:
        config: its configuration, changed as it was asked for.
        state: its latest; None if it was broken off before it had any, and is to begin anew.
        remarks: sentences on what was asked for.
    """

    config: dict[str, Any]
    state: dict[str, Any] | None
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Progress:
    """What every replicate of a run has done, and its limits, each of which ends it.

    Attributes:
        done: by the key of each limit, for one replicate after the other.
        limits: by key, such as `trainer.frames`.
        active: indices of the replicates that had not ended.
        learning_rate_is_zero: whether it has fallen to 0 for good.
    """

    done: tuple[Mapping[str, int], ...]
    limits: Mapping[str, int]
    active: tuple[int, ...]
    learning_rate_is_zero: bool

    @property
    def keys(self) -> str:
        """The keys of the limits."""
        return " or ".join(self.limits)

    @property
    def is_over(self) -> bool:
        """Whether every replicate has reached one of the limits."""
        return all(map(self._has_reached_a_limit, range(len(self.done))))

    @property
    def goes_on(self) -> bool:
        """Whether the replicates that had ended are still at their end."""
        return all(self._has_reached_a_limit(index) for index in range(len(self.done)) if index not in self.active)

    def describe(self) -> str:
        """How far it is, or the first of several replicates."""
        others = f" (the first of {len(self.done)} replicates)" if len(self.done) > 1 else ""
        words = (f"{self.done[0][key]} {key.split('.')[1]} (limit {limit})" for key, limit in self.limits.items())
        return f"it has {' and '.join(words)}{others}"

    def _has_reached_a_limit(self, index: int) -> bool:
        return any(self.done[index][key] >= limit for key, limit in self.limits.items())


def resume(run: Path, overrides: Sequence[str], trust: Sequence[str] = ()) -> Resumption:
    """The run with these overrides of its configuration, such as `trainer.frames=500000`.

    Its configuration may name parts of the trusted modules.

    Raises:
        CarrlError: this is no run's folder, or one that cannot be resumed, or an override is none, not allowed or
            without effect.
    """
    config = load_config(run, trust)
    if not _has_state(run):
        _check_is_whole_run(run, config)
    changes = _parsed(run, overrides)
    _check_cluster(run, config, changes)
    same = [key for key, value in changes.items() if _change(run, config, key, value) and key != "collector.address"]
    state = resumed_state(run, config)
    remarks = [f"{key} is {changes[key]} already" for key in same]
    progress = progress_of(config, state) if state else None
    if progress is None:
        return Resumption(config, state, tuple(remarks))
    if "optimizer.lr" in changes and progress.learning_rate_is_zero:
        raise ConfigError("optimizer.lr would have no effect: learning_rate has come to its end, a share of 0 of it")
    if progress.is_over:
        remarks = [_nothing_left(run, progress, changes)]
    elif not progress.goes_on:
        raise ConfigError(
            f"run '{run}' has replicates that ended before the others; what they did since is not recorded, so they "
            f"cannot go on; leave {progress.keys} as they were"
        )
    return Resumption(config, state, tuple(remarks))


def resumed_state(run: Path, config: Mapping[str, Any]) -> dict[str, Any] | None:
    """The run's latest state; None if it was broken off before it had any, and is to begin anew.

    Raises:
        CheckpointError: it is damaged, or was made with another configuration, or something in the run's folder lies
            elsewhere.
    """
    check_contents(run)
    if not _has_state(run):
        _check_is_whole_run(run, config)
        return None
    state = load_state(run)
    before, now = (_fixed(each) for each in (state.get("config"), config))
    if before != now:
        differing = sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key))
        raise CheckpointError(
            f"run '{run}': {CONFIG} differs from the checkpoint's in {', '.join(differing) or 'everything'}; "
            "put it back, or train anew"
        )
    return state


def check_contents(run: Path) -> None:
    """Checks that all in a run's folder lies there: what is written through a link, a stranger has placed.

    Raises:
        CheckpointError: there is a symbolic link, what is neither a file nor a folder, or a folder in a file's place.
    """
    _check_files(run)
    for folder, folders, files in os.walk(run, onerror=_refuse_unreadable):
        for name in (*folders, *files):
            path = Path(folder, name)
            mode = path.lstat().st_mode
            if stat.S_ISLNK(mode) and not _is_a_loggers(path):
                raise CheckpointError(
                    f"'{path}' is a symbolic link to '{os.readlink(path)}'; a run is resumed only if all of it lies in "
                    "its folder: put there what the link leads to"
                )
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or stat.S_ISLNK(mode)):
                raise CheckpointError(f"'{path}' is neither a file nor a folder; remove it, and the run is resumed")


def _check_files(run: Path) -> None:
    """Refuses a folder where the run would write a file, which it would notice only when it ends."""
    for path in (place / name for place in (run, *run.glob("seed=*")) for name in _FILES):
        if os.path.isdir(path) and not os.path.islink(path):
            raise CheckpointError(
                f"'{path}' is a folder, but the run writes a file there; move it away, and it is resumed"
            )


def _is_a_loggers(link: Path) -> bool:
    home = link.parent
    return home.name == _HAS_LINKS and Path(os.path.realpath(link)).is_relative_to(os.path.realpath(home))


def _refuse_unreadable(error: OSError) -> None:
    raise CheckpointError(f"'{error.filename}' cannot be read: {error.strerror}; make it readable") from error


def _has_state(run: Path) -> bool:
    return (run / STATE).exists() or (run / PREVIOUS).exists()


def _change(run: Path, config: dict[str, Any], key: str, value: Any) -> bool:
    """Sets a value in the configuration; whether it is the one that was there."""
    if config.get("data") and key in _IN_THE_SIMULATOR:
        raise ConfigError(f"{key}={value} would have no effect: run '{run}' learns from logs; how long is data.updates")
    *groups, name = key.split(".")
    node = config
    for group in groups:
        node = node.get(group) or {}
    if name not in node and key != "trainer.checkpoint_interval":  # which runs of older versions do not have
        raise ConfigError(f"run '{run}' has no {key} to be changed")
    is_same = name in node and type(node[name]) is type(value) and bool(node[name] == value)
    node[name] = value
    return is_same


def _nothing_left(run: Path, progress: Progress, changes: Mapping[str, Any]) -> str:
    """The sentence on a run that is over.

    Raises:
        ConfigError: something was to be changed, which a run that is over does not take up.
    """
    done = f"run '{run}' has nothing left to learn: {progress.describe()}"
    if changes:
        typed = ", ".join(f"{key}={value}" for key, value in changes.items())
        raise ConfigError(f"{typed} would have no effect: {done}; give greater limits with it: {progress.keys}")
    return f"{done}; it goes on with greater limits: {progress.keys}"


def _check_cluster(run: Path, config: Mapping[str, Any], changes: Mapping[str, Any]) -> None:
    """Refuses to join a cluster that the run's folder alone names, since it could run any program here."""
    node = config.get("collector")
    address = node.get("address") if isinstance(node, Mapping) else None
    if address is not None and "collector.address" not in changes:
        raise ConfigError(
            f"run '{run}' was driven by a Ray cluster at {shown(address)}; if you trust it, name it again: "
            "collector.address=HOST:PORT; or give collector.address=null for one on this machine"
        )


def _check_is_whole_run(run: Path, config: Mapping[str, Any]) -> None:
    """Refuses a folder whose training is kept elsewhere, or nowhere."""
    if (run.parent / STATE).exists():
        raise CheckpointError(
            f"run '{run}' is one of several seeds that train side by side; resume them together: resume={run.parent}"
        )
    left = [_first_result(folder) for folder in (run, *seed_folders(run))]
    if not any(left):  # killed in its first state, before which it learns nothing
        return
    trainer = config.get("trainer")
    if isinstance(trainer, Mapping) and "checkpoint_interval" in trainer:
        raise CheckpointError(
            f"run '{run}' has {next(filter(None, left))}, but its {STATE} was deleted or moved, and it cannot go on "
            "without; put it back, or train anew in another folder"
        )
    raise CheckpointError(f"run '{run}' was trained by a version of CarRL that kept no {STATE}; train anew")


def _first_result(folder: Path) -> str | None:
    """What is there of a run only once it has learnt, or driven until an episode ended."""
    tables = [folder / name for name in (METRICS, EVALUATIONS)]
    found = [path for path in tables if path.exists() and path.stat().st_size]
    found += [folder / SUMMARY] if (folder / SUMMARY).exists() else []
    found += sorted(folder.glob("checkpoints/*.pt"))
    return str(found[0].relative_to(folder)) if found else None


def _parsed(run: Path, overrides: Sequence[str]) -> dict[str, Any]:
    """The overrides that may change a run, by key."""
    values: dict[str, Any] = {}
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise ConfigError(" ".join(str(error).split())) from error
    for override in parsed:
        key, typed = override.get_key_element(), override.input_line
        if key == "hydra.run.dir" and os.path.realpath(str(override.value())) == os.path.realpath(run):
            continue
        if key.lstrip("+") in CHANGEABLE and key.startswith("+"):
            raise ConfigError(
                f"{typed} cannot be given with resume=, which adds nothing; to change it, leave out the +: "
                f"{str(typed).lstrip('+')}"
            )
        if key not in CHANGEABLE or override.is_sweep_override() or override.is_delete():
            raise ConfigError(f"{typed} cannot be given with resume=; a resumed run may change {', '.join(CHANGEABLE)}")
        if key in values:
            raise ConfigError(f"{key} is given more than once; give it once")
        values[key] = override.value()
    return values


def _fixed(config: Any) -> dict[str, Any]:
    """By key all values that must not change."""
    values = _flat(config, "") if isinstance(config, Mapping) else {}
    return {key: value for key, value in values.items() if key not in CHANGEABLE}


def _flat(node: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key, value in node.items():
        values |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return values


def progress_of(config: Mapping[str, Any], state: Mapping[str, Any]) -> Progress | None:
    """How far the run with this state is; None where its limits are no numbers, as is found out later."""
    updates = state["learner"]["updates"]
    done: list[Mapping[str, int]] = [
        {"trainer.frames": run["status"]["frames"], "trainer.episodes": len(run["episode_returns"])}
        for run in state["runs"]
    ]
    if config.get("data"):
        done = [{"data.updates": updates}]
    values = _flat(config, "")
    limits: dict[str, Any] = {key: values.get(key) for key in done[0]}
    share, decayed_at = values.get("learning_rate.final_share"), values.get("learning_rate.updates")
    if not all(is_whole_number(limit) for limit in limits.values()):
        return None
    is_zero = share == 0 and is_whole_number(decayed_at) and updates >= decayed_at
    return Progress(tuple(done), limits, tuple(state["active"]), is_zero)
