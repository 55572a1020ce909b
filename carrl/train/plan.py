"""What a run is to do: how long, by which replicates, on what, and how often it is evaluated.

Nothing here waits for torch, and `check_early` finds what need not wait for it to be refused.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carrl.config import build_node, is_whole_number, whole
from carrl.errors import ConfigError, shown
from carrl.evaluation.asked import MOST_LAPS
from carrl.log.reader import Log
from carrl.tracks.names import check_may_exist
from carrl.train.files import opponents_config

MOST_REPLICATES = 4096
"""That train side by side."""
MOST_STARTS = 1000
"""On each circuit, of an evaluation."""
LARGEST_SEED = 2**63 - 1
MOST_THREADS = 1024
"""More than any machine has cores; torch takes no number of more than 31 bits."""
_DEVICES = r"(cpu|cuda|hip|hpu|meta|mps|mtia|xla|xpu)(:\d+)?"


@dataclass(frozen=True)
class TrainingPlan:
    """When a run ends, and which replicates train side by side.

    Attributes:
        episodes: a run ends once this many have ended.
        frames: or once this many env steps are done.
        frames_per_update: env steps of each replicate for one update of its network, 1 in the paper.
        seeds: of the replicates, each a whole number or a range such as "0..9", both ends included; None for one.
        checkpoint_interval: wall time between two checkpoints to resume from, s.
    """

    episodes: int
    frames: int
    frames_per_update: int = 1
    seeds: Sequence[int | str] | None = None
    checkpoint_interval: float = 30.0

    def __post_init__(self) -> None:
        """Raises ConfigError unless a run can make at least one step and update."""
        for name in ("episodes", "frames", "frames_per_update"):
            if getattr(self, name) < 1:
                raise ConfigError(f"trainer.{name} is {getattr(self, name)}; it must be at least 1")
        if not self.checkpoint_interval >= 0:
            raise ConfigError(f"trainer.checkpoint_interval is {self.checkpoint_interval}; it must be at least 0 s")

    def replicate_seeds(self, seed: int) -> list[int]:
        """The seeds of all replicates; `seed` is that of the one replicate where no others are named.

        Raises:
            ConfigError: a seed is no whole number of at least 0, or there twice.
        """
        if self.seeds is None:
            return [checked_seed(seed)]
        named = [each for entry in self.seeds for each in _expand(entry)]
        if not named or len(named) > MOST_REPLICATES or len(set(named)) < len(named):
            raise ConfigError(
                f"trainer.seeds is {shown(list(self.seeds))}; "
                f"it must name at least one, none twice, and at most {MOST_REPLICATES}"
            )
        return [checked_seed(each) for each in named]


def checked_seed(seed: Any) -> int:
    """The seed, which is a whole number of at least 0 and fits torch's generators.

    Raises:
        ConfigError: it is not.
    """
    if not is_whole_number(seed) or not 0 <= seed <= LARGEST_SEED:
        remedy = ""
        if isinstance(seed, float) and is_whole_number(whole(seed)):
            remedy = f"; write {shown(whole(seed))}"
        elif isinstance(seed, Sequence) and not isinstance(seed, str):
            remedy = f"; several side by side are trainer.seeds={shown(list(seed))}"
        raise ConfigError(f"seed is {shown(seed)}; it must be a whole number of at least 0 and less than 2^63{remedy}")
    return int(seed)


def checked_threads(threads: Any) -> int:
    """The number of threads.

    Raises:
        ConfigError: it is none.
    """
    if not is_whole_number(threads) or not 1 <= threads <= MOST_THREADS:
        raise ConfigError(f"threads is {shown(threads)}; it must be a whole number from 1 to {MOST_THREADS}")
    return int(threads)


def checked_flag(name: str, value: Any) -> bool:
    """The value, which is true or false.

    Raises:
        ConfigError: it is not.
    """
    if not isinstance(value, bool):
        raise ConfigError(f"{name} is {shown(value)}; it must be true or false")
    return value


def no_such_device(name: Any) -> ConfigError:
    """The error of a device that there is not."""
    return ConfigError(f"device is {shown(name)}, which torch cannot use here; set device=cpu")


def _expand(entry: int | str) -> list[int]:
    if not isinstance(entry, str):
        return [checked_seed(entry)]
    first, dots, last = entry.partition("..")
    numbers = all(end.isdecimal() and len(end) < 20 for end in (first, last))
    if not (dots and numbers and int(first) <= int(last) < int(first) + MOST_REPLICATES):
        raise ConfigError(
            f"trainer.seeds has {shown(entry)}; write seeds as whole numbers or as first..last, as in [0..9]"
        )
    return list(range(int(first), int(last) + 1))


@dataclass(frozen=True)
class Limits:
    """What a replicate's run ends with, each of which does; None is no limit.

    Attributes:
        frames: env steps.
        episodes: ended ones.
        updates: of its networks.
    """

    frames: int | None = None
    episodes: int | None = None
    updates: int | None = None

    def share_done(self, frames: int, episodes: int, updates: int) -> float:
        """How much of the run is done, by the limit that is nearest; 1 or more at its end."""
        pairs = ((frames, self.frames), (episodes, self.episodes), (updates, self.updates))
        return max(done / limit for done, limit in pairs if limit is not None)


@dataclass(frozen=True)
class EvaluationPlan:
    """How often the greedy policy is tried out, and from where.

    Attributes:
        interval: env steps between two evaluations, greedy drives on the validation circuits or the one track.
        starts: places on each of them, spread evenly from its start line on; a drive begins at each.
        laps: of each drive, in a row; where they are several, networks are chosen by the last of them, a flying lap.
        averaged_updates: over which the weights of networks are averaged, exponentially, before they are tried out and
            kept; None for the weights as they are. What is learnt is the same.
    """

    interval: int
    starts: int = 1
    laps: int = 1
    averaged_updates: int | None = None

    def __post_init__(self) -> None:
        """Raises ConfigError unless all are positive."""
        if self.interval < 1:
            raise ConfigError(f"evaluation.interval is {self.interval}; it must be at least 1 env step")
        if not (is_whole_number(self.starts) and 1 <= self.starts <= MOST_STARTS):
            raise ConfigError(f"evaluation.starts is {self.starts}; it must be a whole number from 1 to {MOST_STARTS}")
        if not (is_whole_number(self.laps) and 1 <= self.laps <= MOST_LAPS):
            raise ConfigError(f"evaluation.laps is {self.laps}; it must be a whole number from 1 to {MOST_LAPS}")
        updates = self.averaged_updates
        if not (updates is None or (is_whole_number(updates) and updates >= 1)):
            raise ConfigError(
                f"evaluation.averaged_updates is {shown(updates)}; it must be null or a whole number of at least 1"
            )


@dataclass(frozen=True)
class OfflinePlan:
    """What to learn from instead of the simulator, and for how long.

    Attributes:
        path: a log, or several.
        updates: of each replicate's network.
    """

    path: str | Sequence[str]
    updates: int

    def __post_init__(self) -> None:
        """Raises ConfigError unless there is a log and an update."""
        if not self.paths:
            raise ConfigError(
                "data.path names no log; give at least one, such as outputs/2026-01-31/12-00-00/train.mcap"
            )
        if self.updates < 1:
            raise ConfigError(f"data.updates is {self.updates}; it must be at least 1")

    @property
    def paths(self) -> list[Path]:
        """The logs."""
        return [Path(path) for path in ([self.path] if isinstance(self.path, str) else self.path)]


def check_early(config: Mapping[str, Any]) -> None:
    """Refuses what a run cannot do, as far as that shows before torch is imported; what builds the run checks the rest.

    Raises:
        CarrlError: a plan, a seed, a device, a track, a log or the opponents' run cannot be.
    """
    checked_flag("compile", config["compile"])
    checked_threads(config["threads"])
    if not re.fullmatch(_DEVICES, str(config["device"])):
        raise no_such_device(config["device"])
    plan: TrainingPlan = build_node("trainer", config["trainer"])
    plan.replicate_seeds(config["seed"])
    if config["track"].get("_target_") == "carrl.tracks.track.Track.load":
        check_may_exist(str(config["track"].get("name_or_path")))
    opponents = config.get("opponents") or {}
    if opponents.get("_target_") == "carrl.opponents.policy.PolicyOpponents":
        opponents_config(str(opponents.get("run")))
    if not config.get("data"):
        build_node("evaluation", config["evaluation"])
        return
    offline: OfflinePlan = build_node("data", config["data"])
    for path in offline.paths:
        with Log(path):  # which reads where everything is
            pass
