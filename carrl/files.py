"""A way onto the disk that never leaves half a file, and a way from it that never takes in more than it should."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from carrl.errors import CarrlError

PARTIAL = ".*.partial"
"""Matches the files that a killed process may leave behind."""
_CHUNK_BYTES = 2**24


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


def check_may_appear(path: str | Path, error: type[CarrlError] = CarrlError) -> None:
    """Tells before long work what `appearing_whole` would tell after it.

    Raises:
        CarrlError: or the kind of it that `error` is: the path is a folder, or is in none that may be written to.
    """
    path, reason = Path(path), 0
    if path.is_dir():
        reason = errno.EISDIR
    elif not path.parent.exists():
        reason = errno.ENOENT
    elif not path.parent.is_dir():
        reason = errno.ENOTDIR
    elif not os.access(path.parent, os.W_OK):
        reason = errno.EACCES
    if reason:
        raise error(f"'{path}' cannot be written: {os.strerror(reason)}; choose another place")


def remove_left_overs(*folders: Path) -> None:
    """Removes what killed processes left of files that they were writing in these folders, which may be missing."""
    for folder in folders:
        for partial in folder.glob(PARTIAL):
            if partial.is_symlink() or not partial.is_dir():  # a folder is not what they left
                partial.unlink()


def write_whole(path: str | Path, content: bytes, error: type[CarrlError] = CarrlError, durably: bool = False) -> None:
    """Writes a file as `appearing_whole` lets it appear; `durably` waits until the disk has it."""
    with appearing_whole(path, error) as partial, partial.open("wb") as file:
        file.write(content)
        if durably:
            file.flush()
            os.fsync(file.fileno())


def read_whole(
    path: Path, most: int, name: str, error: type[CarrlError] = CarrlError, *, follow_links: bool = True
) -> bytes:
    """All bytes of a regular file of at most `most`.

    Args:
        path: of the file.
        most: how many bytes it may have.
        name: what the file is called in messages, such as "track 'oval.csv'".
        error: the kind of error to raise.
        follow_links: whether a link to a file will do.

    Raises:
        CarrlError: it is missing, larger, a folder, a pipe or a device, or cannot be read.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting if follow_links else open_itself) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # a pipe would block, a device might never end
                raise error(f"{name}: this is not a regular file; name one")
            content = _read_at_most(file, most + 1)
    except IsADirectoryError:
        raise error(f"{name}: this is a folder; name a file in it") from None
    except (OSError, ValueError) as failure:  # ValueError: a NUL in the path
        raise error(f"{name}: cannot be read: {getattr(failure, 'strerror', None) or failure}") from failure
    if len(content) > most:
        raise error(f"{name}: the file is too large; it may have at most {most} bytes")
    return content


def _read_at_most(file: BinaryIO, most: int) -> bytes:
    """Reads bit by bit, since one `read` sets aside as much memory as it may return, however small the file is."""
    chunks: list[bytes] = []
    while most > 0 and (chunk := file.read(min(most, _CHUNK_BYTES))):
        chunks.append(chunk)
        most -= len(chunk)
    return b"".join(chunks)


def _open_without_waiting(path: str, flags: int) -> int:
    """Opens a pipe, too, without waiting for someone to write to it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def open_itself(path: str, flags: int) -> int:
    """An opener for `open` that follows no link in the file's place, nor waits for the other end of a pipe.

    Raises:
        OSError: there is a link, or the file cannot be opened.
    """
    try:
        return os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as failure:
        if failure.errno == errno.ELOOP and os.path.islink(path):
            raise OSError(errno.ELOOP, "it is a symbolic link", str(path)) from None
        raise
