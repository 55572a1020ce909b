"""What a run learns from that lies outside its folder, by checksum, so that it goes on with the same or not at all."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from carrl.errors import CheckpointError, LogError
from carrl.tracks.circuits import Circuits
from carrl.tracks.track import Track

Inputs = Mapping[str, str]
"""A checksum for each track and log by its name, such as "track 'oval.csv'"."""


def checksums(circuits: Circuits, logs: Iterable[Path] = ()) -> dict[str, str]:
    """The checksums of the tracks as they are driven, and of the logs' bytes.

    Raises:
        LogError: a log cannot be read.
    """
    found: dict[str, str] = {}
    for track in dict.fromkeys((*circuits.training, *circuits.validation)):
        name = f"track '{track.name}'"
        found[name if name not in found else f"{name} ({len(found)})"] = _of_track(track)
    return found | {f"log '{path}'": _of_log(path) for path in logs}


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


def _of_track(track: Track) -> str:
    digest = hashlib.sha256(f"{track.gate_count} {track.bridges}".encode())
    for part in (track.centreline, track.left_wall, track.right_wall):
        digest.update(part.contiguous().numpy().tobytes())
    return digest.hexdigest()


def _of_log(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise LogError(f"log '{path}': cannot be read: {error.strerror}; give the path of a log") from error
