"""The bytes of a track's file, read within bounds."""

from pathlib import Path

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
