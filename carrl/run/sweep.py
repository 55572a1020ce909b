"""The folder of a sweep: a folder for each of its jobs, how each stands, and the wish to end.

multirun.yaml   what was asked for, as Hydra notes it
JOB/job.json    how a job stands
stop            there once the sweep is to end: running jobs save and end, no further one begins
"""

import json
import re
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from typing import Any, Literal

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.run.files import LOG, SUMMARY, read_text

JOB = "job.json"
STOP = "stop"
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
            CarrlError: the disk refuses it.
        """
        write_whole(folder / JOB, (json.dumps(asdict(self)) + "\n").encode())


@dataclass(frozen=True)
class SweepFolder:
    """A sweep's folder."""

    path: Path

    def begin(self) -> None:
        """Forgets how the jobs of an earlier sweep in this folder stood; their results stay."""
        for left_over in (*self.path.rglob(JOB), *self.path.glob(STOP)):
            left_over.unlink(missing_ok=True)

    def stop(self) -> None:
        """Asks all jobs, on whatever machine, to end."""
        self.path.mkdir(parents=True, exist_ok=True)
        (self.path / STOP).touch()

    @property
    def is_to_stop(self) -> bool:
        """Whether someone asked for the sweep's end."""
        return (self.path / STOP).exists()

    def notes(self) -> dict[Path, JobNote]:
        """How the jobs stand that have begun, by folder, in the order of the sweep."""
        notes = {}
        for file in self.path.rglob(JOB):
            try:
                notes[file.parent] = JobNote(**json.loads(read_text(file)))
            except (CarrlError, ValueError, TypeError):  # of another program, or gone since
                continue
        return dict(sorted(notes.items(), key=lambda item: item[1].number))


def read_summaries(job: Path) -> list[dict[str, Any]]:
    """The summaries of a job's agents, by seed; none of those that have not come so far."""
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
