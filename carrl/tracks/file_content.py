"""The bytes of a track's file, read within bounds."""

import os
from pathlib import Path

from carrl.errors import TrackError
from carrl.files import read_whole

MAX_FILE_BYTES = 16 * 2**20


def read_content(path: Path, most: int = MAX_FILE_BYTES) -> bytes:
    """All bytes of a regular file that has at most `most`.

    Raises:
        TrackError: it has more, is a folder, a pipe or a device, or cannot be read.
    """
    if os.path.isdir(path):
        raise TrackError(f"track '{path}': this is a folder; name a file in it")
    return read_whole(path, most, f"track '{path.name}'", TrackError)
