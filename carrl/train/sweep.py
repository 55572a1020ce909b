"""The folder of a sweep: a folder for each of its jobs, how each stands, and the wish to end.

multirun.yaml   what was asked for, as Hydra notes it
JOB/job.json    how a job stands
stop            there once the sweep is to end: running jobs save and end, no further one begins

Files by these names that no sweep of CarRL wrote, or that belong to a sweep further below, are left alone.
"""

import json
import os
import re
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from typing import Any, Literal, get_args

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.train.files import LOG, SUMMARY, read_text

JOB = "job.json"
STOP = "stop"
_WISH = "the sweep is to end\n"
_PATHS = {"track.name_or_path": "track", "data.path": "data"}
"""Keys whose values are files, and what they are called in a job's name."""
_LONGEST_NAME = 120

JobState = Literal["running", "finished", "finished before", "interrupted", "failed"]


@dataclass(frozen=True)
class JobNote:
    """How a job stands.

    Attributes:
        number: its place in the sweep, from 0.
        name: of its folder.
        state: "finished before" of one that an earlier sweep into the same folder had finished.
        seconds: that it took.
        error: what ended it, if it failed.
    """

    number: int
    name: str
    state: JobState
    seconds: float = 0.0
    error: str | None = None

    def write(self, folder: Path) -> None:
        """Leaves the note in the job's folder.

        Raises:
            CarrlError: the disk refuses it, or something else by that name is there.
        """
        if os.path.lexists(folder / JOB) and read_note(folder / JOB) is None:
            raise CarrlError(f"'{folder / JOB}' is in the way of a sweep's note and not one itself; move it away")
        write_whole(folder / JOB, (json.dumps(asdict(self)) + "\n").encode())


@dataclass(frozen=True)
class SweepFolder:
    """A sweep's folder."""

    path: Path

    def begin(self) -> None:
        """Forgets how the jobs of an earlier sweep in this folder stood; their results stay.

        Raises:
            CarrlError: something is in the way of the wish to end.
        """
        stop = self.path / STOP
        if os.path.lexists(stop):
            if not _is_wish(stop):
                raise CarrlError(f"'{stop}' would end the sweep, and it is none that this version wrote; move it away")
            stop.unlink(missing_ok=True)
        for folder in self.notes():
            (folder / JOB).unlink(missing_ok=True)

    def stop(self) -> None:
        """Asks all jobs, on whatever machine, to end."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_whole(self.path / STOP, _WISH.encode())

    @property
    def is_to_stop(self) -> bool:
        """Whether someone asked for the sweep's end."""
        return (self.path / STOP).is_file()

    def notes(self) -> dict[Path, JobNote]:
        """How the jobs stand that have begun, by folder, in the order of the sweep."""
        found = {file.parent: read_note(file) for file in self.path.rglob(JOB)}
        notes = {
            folder: note for folder, note in found.items() if note and note.name == os.path.relpath(folder, self.path)
        }
        return dict(sorted(notes.items(), key=lambda item: item[1].number))


def read_note(file: Path) -> JobNote | None:
    """The note in a file; None if it is another program's, or gone."""
    try:
        note = JobNote(**json.loads(read_text(file)))
    except (CarrlError, ValueError, TypeError):
        return None
    return note if isinstance(note.number, int) and note.state in get_args(JobState) else None


def _is_wish(file: Path) -> bool:
    """Whether this is the file by which a sweep asks its jobs to end."""
    try:
        return read_text(file) == _WISH
    except CarrlError:
        return False


def read_summaries(job: Path) -> list[dict[str, Any]]:
    """The summaries of a job's replicates, by seed; none of those that have not come so far."""
    summaries = {}
    for file in (*job.glob(SUMMARY), *job.glob(f"seed=*/{SUMMARY}")):
        try:
            summary = json.loads(read_text(file))
            summaries[int(summary["seed"])] = summary
        except (CarrlError, ValueError, KeyError, TypeError):  # damaged, and to be trained anew
            continue
    return [summaries[seed] for seed in sorted(summaries)]


def job_name(overrides: Sequence[str], fixed: Collection[str] = ()) -> str:
    """The name of a job's folder: its overrides but for those of the keys that do not vary, files without folders.

    Where nothing varies, all overrides are named.
    """
    pairs = [override.partition("=")[::2] for override in overrides]
    varying = [pair for pair in pairs if pair[0] not in fixed] or pairs
    name = ",".join(f"{_PATHS.get(key, key)}={_stem_of(value)}" for key, value in varying)
    return re.sub(r"[^\w.,=+\[\]-]+", "-", name).lstrip(".")[:_LONGEST_NAME] or "job"


def _stem_of(value: str) -> str:
    """The value, with each path in it cut to its stem; a log by the name of its run, since all logs are named alike."""
    if "/" not in value:
        plain = value.replace("'", "").replace('"', "")
        return plain.lower() if plain in ("True", "False") else plain  # which Hydra writes so
    paths = [PurePath(part.strip("[]'\" ")) for part in value.split(",")]
    return "+".join(path.parent.name if path.name == LOG else path.stem for path in paths)
