"""What lies where in a run's folder, its small files, and checksums of its inputs; nothing here waits for torch.

.hydra/config.yaml    the resolved configuration
train.mcap            every transition
checkpoints/          best.pt and last.pt; state.pt and the one before, to resume from
metrics.csv           a row for each ended episode
evaluations.csv       a row for each greedy drive during training
summary.json          the run in a few figures
learning_curve.png, lap.png
"""

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.config import check_targets, foreign_targets
from carrl.errors import CarrlError, CheckpointError, ConfigError, LogError, shown
from carrl.files import read_whole, write_whole
from carrl.plain_yaml import parse_yaml

if TYPE_CHECKING:
    from carrl.tracks.circuits import Circuits
    from carrl.tracks.track import Track

CONFIG = Path(".hydra/config.yaml")
LOG = "train.mcap"
METRICS = "metrics.csv"
EVALUATIONS = "evaluations.csv"
SUMMARY = "summary.json"
LEARNING_CURVE = "learning_curve.png"
LAP = "lap.png"
_CONFIG_KEYS = ("track", "vehicle", "sensor", "reward", "env", "network", "seed")
MAX_TEXT_BYTES = 64 * 2**20
MAX_CONFIG_BYTES = 2**18
"""Eighty times what training writes."""


def checkpoint_path(run: Path, name: str) -> Path:
    """Where a run keeps the checkpoint of this name, `best` or `last`."""
    return run / "checkpoints" / f"{name}.pt"


def seed_folders(run: Path) -> list[Path]:
    """The folders of a run's seeds in their order, where it has several; else the run's own."""
    if not os.path.isdir(run):
        return [run]
    found = [path.parents[1] for path in run.glob(f"seed=*/{CONFIG}") if path.parents[1].name[5:].isdecimal()]
    return sorted(found, key=lambda folder: int(folder.name[5:])) or [run]


def load_config(run: Path, trust: Iterable[str] = ()) -> dict[str, Any]:
    """The resolved configuration of a run, as plain values that may be built from.

    Args:
        run: its folder.
        trust: modules of one's own whose parts it may name, as `carrl.config.check_targets` takes them.

    Raises:
        CarrlError: this is no run's folder, or its configuration is damaged, or names what is not trusted.
    """
    config = read_config(run)
    try:
        check_targets(config, trust)
    except ConfigError as error:
        raise ConfigError(f"run '{run}': {error}") from error
    return config


def opponents_config(run: str) -> dict[str, Any]:
    """The configuration of the run, `opponents.run`, whose best network is to drive opponents.

    Raises:
        CarrlError: there is no such run, it has several seeds, no network yet, or parts of somebody's own.
    """
    folders = seed_folders(Path(run))
    if not os.path.isdir(run):
        raise ConfigError(f"opponents.run is '{run}', which is no folder; name a run's, or put that back where it was")
    if folders != [Path(run)]:
        raise ConfigError(f"opponents.run is '{run}', a run of {len(folders)} seeds; name one, such as '{folders[0]}'")
    try:
        foreign = foreign_targets(read_config(Path(run)))
    except CarrlError as error:
        raise ConfigError(f"opponents.run is '{run}', which cannot be read as a run: {error}") from error
    if foreign:
        place, target = next(iter(foreign.items()))
        raise ConfigError(
            f"opponents.run is '{run}', whose {place} is {shown(target)}; only a run with CarRL's own parts can drive "
            "opponents"
        )
    config = load_config(Path(run))
    if not os.path.isfile(checkpoint_path(Path(run), "best")):
        raise ConfigError(f"opponents.run is '{run}', which has no best network yet; wait for its first evaluation")
    return config


def read_config(run: Path) -> dict[str, Any]:
    """The resolved configuration of a run to be looked at only: nothing may be built from it before `check_targets`.

    Raises:
        CheckpointError: this is no run's folder, or its configuration is damaged.
    """
    if not os.path.isdir(run):  # Path.is_dir raises on a name that is too long or may not be looked up
        raise CheckpointError(f"run '{run}' is not a folder; name a run's, such as outputs/2026-01-31/12-00-00")
    config = _parsed(run / CONFIG, f"run '{run}': {CONFIG}")
    missing = [key for key in _CONFIG_KEYS if not isinstance(config, dict) or key not in config]
    if missing:
        raise CheckpointError(f"run '{run}': {CONFIG} lacks {', '.join(missing)}; it is not what training wrote")
    return config


def read_yaml(path: Path) -> Any:
    """What a run's YAML file holds, as plain values, bounded in size with every alias written out.

    Raises:
        CheckpointError: the file is missing, too large, no regular file or no such YAML.
    """
    return _parsed(path, f"'{path}'")


def _parsed(path: Path, name: str) -> Any:
    try:
        return parse_yaml(_read_bytes(path, MAX_CONFIG_BYTES))
    except ValueError as error:
        raise CheckpointError(f"{name}: {error}") from error


def read_text(path: Path) -> str:
    """The text of a run's file, bounded in size.

    Raises:
        CheckpointError: the file is missing, too large, no regular file or no text.
    """
    try:
        return _read_bytes(path, MAX_TEXT_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise CheckpointError(f"'{path}' is no text: {error.reason}") from error


def _read_bytes(path: Path, most: int) -> bytes:
    if not os.path.lexists(path):
        raise CheckpointError(f"'{path}' does not exist; a run's folder has it")
    return read_whole(path, most, f"'{path}'", CheckpointError)


def write_text(path: Path, text: str) -> None:
    """Writes a file whole or not at all.

    Raises:
        CarrlError: the disk refuses it.
    """
    write_whole(path, text.encode())


Inputs = Mapping[str, str]
"""A checksum for each track, log and file of the opponents by its name, such as "track 'oval.csv'"."""


def checksums(circuits: "Circuits", logs: Iterable[Path] = (), opponents: Iterable[Path] = ()) -> dict[str, str]:
    """The checksums of the tracks as they are driven, and of the bytes of logs and of what opponents were read from.

    Raises:
        LogError: a log cannot be read.
        ConfigError: a file of the opponents cannot.
    """
    found: dict[str, str] = {}
    for track in dict.fromkeys((*circuits.training, *circuits.validation)):
        name = f"track '{track.name}'"
        found[name if name not in found else f"{name} ({len(found)})"] = _of_track(track)
    found |= {f"log '{path}'": _of_file(path, "log", LogError) for path in logs}
    return found | {f"opponents' file '{path}'": _of_file(path, "opponents' file", ConfigError) for path in opponents}


def check_inputs(run: Path, before: Inputs, now: Inputs) -> None:
    """Refuses to go on with other tracks or logs.

    Raises:
        CheckpointError: they are not those that the run began with.
    """
    differing = sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))
    if differing:
        named = ", ".join(_describe(name, before, now) for name in differing[:3])
        more = f" and {len(differing) - 3} more" if len(differing) > 3 else ""
        raise CheckpointError(
            f"run '{run}' began with other inputs: {named}{more}; put back what it learnt from, or train anew"
        )


def _describe(name: str, before: Inputs, now: Inputs) -> str:
    return f"{name} {'is new' if name not in before else 'is missing' if name not in now else 'was changed'}"


def _of_track(track: "Track") -> str:
    digest = hashlib.sha256(f"{track.gate_count} {track.bridges}".encode())
    for part in (track.centreline, track.left_wall, track.right_wall):
        digest.update(part.contiguous().numpy().tobytes())
    return digest.hexdigest()


def _of_file(path: Path, kind: str, refusal: type[CarrlError]) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise refusal(f"{kind} '{path}': cannot be read: {error.strerror}; give the path of one that can") from error
