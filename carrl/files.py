"""A way onto the disk that never leaves half a file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from carrl.errors import CarrlError

PARTIAL = ".*.partial"
"""Matches the files that a killed process may leave behind."""


@contextmanager
def appearing_whole(path: str | Path, error: type[CarrlError] = CarrlError) -> Iterator[Path]:
    """Yields a place to write to, and moves what is there to `path` unless something fails.

    A reader sees the old file or the new one and never a part.

    Raises:
        CarrlError: or the kind of it that `error` is: the file cannot be written there.
    """
    path = Path(path)
    partial = path.parent / f".{uuid4().hex}.partial"  # no part of the name, which may be as long as names may be
    try:
        yield partial
        os.replace(partial, path)
    except (OSError, ValueError) as failure:  # ValueError: a NUL in the path
        reason = getattr(failure, "strerror", None) or failure
        raise error(f"'{path}' cannot be written: {reason}; choose another place") from failure
    finally:
        with suppress(OSError, ValueError):
            partial.unlink()


def remove_left_overs(*folders: Path) -> None:
    """Removes what killed processes left of files that they were writing in these folders, which may be missing."""
    for folder in folders:
        for partial in folder.glob(PARTIAL):
            partial.unlink()


def write_whole(path: str | Path, content: bytes, error: type[CarrlError] = CarrlError, durably: bool = False) -> None:
    """Writes a file as `appearing_whole` lets it appear; `durably` waits until the disk has it."""
    with appearing_whole(path, error) as partial, partial.open("wb") as file:
        file.write(content)
        if durably:
            file.flush()
            os.fsync(file.fileno())
