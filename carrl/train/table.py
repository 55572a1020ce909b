"""A CSV file that grows row by row."""

import csv
import logging
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carrl.errors import CarrlError, CheckpointError
from carrl.files import open_itself, write_whole

_logger = logging.getLogger(__name__)


def check_table(path: Path, text: str) -> int:
    """How many lines of a table's text are in its file: all of them, or the first ones only.

    Raises:
        CheckpointError: the file says otherwise, or is none.
        OSError: it cannot be read.
    """
    content = text.encode()
    found = _beginning(path, len(content))
    if not content.startswith(found):
        pairs = zip(content.splitlines(), found.splitlines(), strict=False)
        line = next(number for number, (own, other) in enumerate(pairs, start=1) if own != other)
        raise CheckpointError(
            f"'{path}': line {line} is not as the run wrote it; put it back, or move the file away, and it is written "
            "anew as it was"
        )
    return found.count(b"\n")


def _beginning(path: Path, size: int) -> bytes:
    """The first bytes of a file; none where there is no file."""
    try:
        with open(path, "rb", opener=open_itself) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise CheckpointError(f"'{path}' is not a regular file; move it away")
            return file.read(size)
    except FileNotFoundError:
        return b""


class Table:
    """A CSV file being written; its header is the first row's keys.

    Args:
        path: of the file; a link in its place is not followed.
        text: all of it as it was, to go on with it from there. What follows in the file is cut off; what is missing at
            its end, or all of it, is written anew.

    Raises:
        CheckpointError: the file says otherwise than the text.
        CarrlError: the file cannot be written.
    """

    def __init__(self, path: Path, text: str = "") -> None:
        """Opens the file."""
        self._path = path
        self._writer: csv.DictWriter[str] | None = None
        content = text.encode()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            missing = content.count(b"\n") - check_table(path, text)
            if missing:
                _logger.warning("'%s' lacked %d of its lines, which the checkpoint puts back.", path, missing)
            write_whole(path, content)
            self._file = open(path, "a+", newline="", encoding="utf-8", buffering=1, opener=open_itself)  # noqa: SIM115
        except OSError as error:
            raise self._unwritable(error) from error

    @property
    def is_in_place(self) -> bool:
        """Whether the path leads to the file that is written."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except OSError:
            return False

    @property
    def text(self) -> str:
        """All that is written so far.

        Raises:
            CarrlError: the disk refuses it.
        """
        return self._content.decode()

    @property
    def _content(self) -> bytes:
        try:
            return os.pread(self._file.fileno(), os.fstat(self._file.fileno()).st_size, 0)
        except OSError as error:
            raise self._unwritable(error) from error

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row.

        Raises:
            CarrlError: the disk refuses it.
        """
        try:
            if self._writer is None:
                self._writer = csv.DictWriter(self._file, list(row))
                if self._file.tell() == 0:
                    self._writer.writeheader()
            self._writer.writerow(row)
        except OSError as error:
            raise self._unwritable(error) from error

    def put_back(self) -> None:
        """Writes the file anew at its place, which was deleted or moved; it is not to be appended to afterwards.

        Raises:
            CarrlError: the disk refuses it.
        """
        write_whole(self._path, self._content)

    def close(self) -> None:
        """Completes the file.

        Raises:
            CarrlError: the disk refuses it.
        """
        try:
            self._file.close()
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> CarrlError:
        return CarrlError(f"'{self._path}' cannot be written: {error.strerror}; choose another place")
