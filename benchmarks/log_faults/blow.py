"""Signals that a training run sends to itself at a chosen place: in the middle of a write, or at a renaming."""

import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

CHECKPOINT, RENAMING, LOG = "checkpoint", "renaming", "log"
_PLACES, _STRUCK = "places", "struck"


@dataclass(frozen=True)
class Blow:
    """Where a run sends itself a signal.

    Attributes:
        signal: its number.
        place: CHECKPOINT or LOG: in the middle of a write; RENAMING: before or after a renaming of a state.
        number: of the place among those of its kind, from 0.
        share: of the bytes that are written before; at a renaming, it comes before if the share is less than a half.
    """

    signal: int
    place: str
    number: int
    share: float


class Watch:
    """Counts in the run the places that it comes to, and strikes where the blow says.

    Args:
        folder: of the `TrainingRun`.
        blow: None only to count.
    """

    def __init__(self, folder: Path, blow: Blow | None = None) -> None:
        self._folder, self._blow = folder, blow
        self._passed: Counter[str] = Counter()

    def patches(self) -> Iterator[Any]:
        """What to put in the place of CarRL's functions, made in the run itself."""
        from carrl.log import mcap_write
        from carrl.train import checkpoint

        self._write_at, self._replace = mcap_write._write_at, os.replace
        yield patch.object(checkpoint, "write_whole", self._write_checkpoint)
        yield patch.object(os, "replace", self._rename)
        yield patch.object(mcap_write, "_write_at", self._write_log)

    def strike(self, number: int) -> None:
        """Sends the signal, and leaves a note of when."""
        (self._folder / _STRUCK).write_text(repr(time.monotonic()))
        os.kill(os.getpid(), number)

    def _struck_here(self, place: str) -> Blow | None:
        """The blow if it is to come now."""
        number = self._passed[place]
        self._passed[place] += 1
        if self._blow is None:
            with (self._folder / _PLACES).open("a") as file:
                file.write(f"{place}\n")
        elif (self._blow.place, self._blow.number) == (place, number):
            return self._blow
        return None

    def _write_checkpoint(self, path: Path, content: bytes, error: type[Any], durably: bool = False) -> None:
        """As `carrl.files.write_whole`, with a blow in the middle."""
        from carrl.files import appearing_whole

        blow = self._struck_here(CHECKPOINT)
        cut = round(blow.share * len(content)) if blow else len(content)
        with appearing_whole(path, error) as partial, partial.open("wb") as file:
            file.write(content[:cut])
            file.flush()
            if blow:
                self.strike(blow.signal)
            file.write(content[cut:])
            if durably:
                file.flush()
                os.fsync(file.fileno())

    def _rename(self, source: Any, target: Any) -> None:
        from carrl.train.checkpoint import PREVIOUS, STATE

        is_state = Path(target).name in (PREVIOUS.name, STATE.name) and Path(source).exists()
        blow = self._struck_here(RENAMING) if is_state else None
        if blow and blow.share < 0.5:
            self.strike(blow.signal)
        self._replace(source, target)
        if blow and blow.share >= 0.5:
            self.strike(blow.signal)

    def _write_log(self, descriptor: int, content: bytes, offset: int) -> None:
        blow = self._struck_here(LOG)
        if blow:
            os.pwrite(descriptor, content[: round(blow.share * len(content))], offset)
            self.strike(blow.signal)
        self._write_at(descriptor, content, offset)


def places_in(folder: Path) -> Counter[str]:
    """How many places of each kind a run came to that was only watched."""
    return Counter((folder / _PLACES).read_text().split())


def struck_s(folder: Path) -> float | None:
    """When the run struck itself, on this machine's monotonic clock; None if it did not. The note is taken away."""
    note = folder / _STRUCK
    if not note.exists():
        return None
    moment_s = float(note.read_text())
    note.unlink()
    return moment_s
