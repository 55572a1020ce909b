"""The circuits that a policy is trained on, and those on which training tries out how well it drives."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from carrl.errors import TrackError, shown
from carrl.tracks.formats import READERS
from carrl.tracks.library import files_below
from carrl.tracks.random_track import CORNER_RADIUS, CORNER_SPACING, LENGTH, WIDTH
from carrl.tracks.track import Track

_logger = logging.getLogger(__name__)

MOST_CIRCUITS = 512
"""Of a run; each one is attached to the run's log, with about 75 bytes for every metre of its road."""


@dataclass(frozen=True, eq=False)
class Circuits:
    """One track, or many.

    Attributes:
        training: where the policy learns to drive.
        validation: where it is tried out without exploration, to choose the best network; not among `training`, unless
            there is one track for both.
    """

    training: tuple[Track, ...]
    validation: tuple[Track, ...]

    @staticmethod
    def only(track: Track) -> "Circuits":
        """One track to learn and to be tried out on."""
        return Circuits((track,), (track,))

    @property
    def all(self) -> tuple[Track, ...]:
        """Each of them once."""
        return tuple(dict.fromkeys((*self.training, *self.validation)))

    @property
    def name(self) -> str:
        """The one track's name, or how many there are."""
        return self.training[0].name if len(self.training) == 1 else f"{len(self.training)} circuits"


def make_circuits(
    count: int,
    validation: int,
    seed: int = 0,
    corner_radius: float | Sequence[float] = CORNER_RADIUS,
    width: float | Sequence[float] = WIDTH,
    length: float | Sequence[float] = LENGTH,
    gate_spacing: float | None = None,
    widening: float = 0.0,
    corner_spacing: float | Sequence[float] = CORNER_SPACING,
    hairpins: float = 0.0,
    folder: str | None = None,
    scale: float = 1.0,
) -> Circuits:
    """Random circuits to learn on, with the circuits of a folder if one is named, and other random ones for trials.

    Args:
        count: how many random circuits to learn on.
        validation: how many to be tried out on; from the seeds that follow those of the first ones.
        seed: of the first random circuit; the next one is drawn from the next seed, and so on.
        corner_radius: see `Track.random`, as for all that follow but `folder`.
        width: from wall to wall, m.
        length: of the centreline, m.
        gate_spacing: about how far the gates stand apart, m, also in the folder's circuits.
        widening: how much wider either half of a random road may be in places, as a share.
        corner_spacing: about how far corners stand apart, in least radii.
        hairpins: share of the narrow U-turns that are one acute corner instead of two right-angled ones.
        folder: whose circuits, and those of folders below it, to learn on, too; None for none. Files in it that
            cannot be read are left out, with a warning for each.
        scale: how many times as large as in their files the circuits of the folder are.

    Raises:
        TrackError: there is no circuit to learn on or for trials, there are too many, or one cannot be drawn or read.
    """
    if count < 0 or validation < 1 or count + validation > MOST_CIRCUITS:
        raise TrackError(
            f"track.count is {count} and track.validation is {validation}; they must be at least 0 and 1, "
            f"together at most {MOST_CIRCUITS}"
        )
    drawn = [
        Track.random(each, corner_radius, width, length, gate_spacing, widening, corner_spacing, hairpins)
        for each in range(seed, seed + count + validation)
    ]
    if folder is None and scale != 1:
        raise TrackError(f"track.scale is {shown(scale)}, but track.folder names no folder to scale; leave it out")
    named = [] if folder is None else _load_or_warn(Path(folder), gate_spacing, scale)
    training = (*drawn[:count], *named)
    if not training:
        raise TrackError("track.count is 0 and track.folder names no folder; give at least one circuit to learn on")
    return Circuits(training, tuple(drawn[count:]))


def _load_or_warn(folder: Path, gate_spacing: float | None, scale: float) -> list[Track]:
    tracks, refused = load_folder(folder, gate_spacing, scale)
    for path, reason in refused.items():
        _logger.warning("left out '%s': %s", path, reason)
    return tracks


class FolderError(TrackError):
    """A folder without a circuit.

    Attributes:
        refused: of each file in it that is none, its path and the sentence that says why.
    """

    def __init__(self, message: str, refused: dict[Path, str] | None = None) -> None:
        super().__init__(message)
        self.refused = refused or {}


class Folder(NamedTuple):
    """What a folder holds.

    Attributes:
        tracks: its circuits, those in folders below it named by their path from there.
        refused: of each file that is none, its path and the sentence that says why.
    """

    tracks: list[Track]
    refused: dict[Path, str]


def load_folder(folder: Path, gate_spacing: float | None = None, scale: float = 1.0) -> Folder:
    """Loads all circuits of a folder and of those below it, and tells which files could not be read.

    Raises:
        FolderError: none of them could be read, or there are too many.
        TrackError: there is no such folder.
    """
    tracks: list[Track] = []
    refused: dict[Path, str] = {}
    for path in circuit_files(folder):
        try:
            found = Track.load_all(path, gate_spacing, scale)
        except TrackError as error:
            refused[path] = str(error)
        else:
            below = path.parent.relative_to(folder).as_posix()
            tracks += [replace(track, name=str(PurePosixPath(below, track.name))) for track in found]
    if not tracks:
        reasons = "; ".join(refused.values())
        raise FolderError(f"folder '{folder}' has no file that can be read as a track: {reasons}", refused)
    return Folder(tracks, refused)


def circuit_files(folder: Path) -> list[Path]:
    """The files of a folder, and of those below it that are not hidden, that are taken for circuits, in order.

    Raises:
        FolderError: there is none, or too many.
        TrackError: there is no such folder.
    """
    found = sorted(islice(files_below(folder), MOST_CIRCUITS + 1))
    if not 0 < len(found) <= MOST_CIRCUITS:
        count = f"more than {MOST_CIRCUITS}" if found else "0"
        raise FolderError(
            f"folder '{folder}' has {count} files that end in {', '.join(READERS)}; "
            f"it must have at least one and at most {MOST_CIRCUITS}"
        )
    return found
