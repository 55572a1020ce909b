"""The bytes of a track's file: read within bounds, written whole or not at all."""

import os
from pathlib import Path
from uuid import uuid4

from carrl.errors import TrackError

MAX_FILE_BYTES = 16 * 2**20


def read_content(path: Path, most: int = MAX_FILE_BYTES) -> bytes:
    """All bytes of a file that has at most `most`.

    Raises:
        TrackError: it has more, or cannot be read.
    """
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except IsADirectoryError:
        raise TrackError(f"track '{path}': this is a folder; name a file in it") from None
    except OSError as error:
        raise TrackError(f"track '{path}': cannot be read: {error.strerror}") from error
    if len(content) > most:
        raise TrackError(f"track '{path.name}': the file is too large; it may have at most {most} bytes")
    return content


def write_content(path: Path, content: bytes) -> None:
    """Writes a file, so that a reader sees the old bytes or the new ones and never a part.

    Raises:
        TrackError: it cannot be written there.
    """
    partial = path.with_name(f".{path.name}.{uuid4().hex}.partial")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        raise TrackError(f"'{path}' cannot be written: {error.strerror}") from error
    finally:
        partial.unlink(missing_ok=True)
