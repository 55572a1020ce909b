"""A CSV file that grows row by row."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carrl.errors import CarrlError
from carrl.files import write_whole


class Table:
    """A CSV file being written; its header is the first row's keys.

    Args:
        path: of the file.
        rows: of the existing file that are kept; what follows them is cut off.

    Attributes:
        rows: in the file.

    Raises:
        CarrlError: the file cannot be written.
    """

    def __init__(self, path: Path, rows: int = 0) -> None:
        """Opens the file."""
        self._path = path
        self._writer: csv.DictWriter[str] | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            kept = path.read_bytes().splitlines(keepends=True)[: rows + 1] if rows and path.exists() else []
            write_whole(path, b"".join(kept))
            self._file = path.open("a+", newline="", encoding="utf-8", buffering=1)
        except OSError as error:
            raise self._unwritable(error) from error
        self.rows = max(0, len(kept) - 1)

    @property
    def is_in_place(self) -> bool:
        """Whether the path leads to the file that is written."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except OSError:
            return False

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
        self.rows += 1

    def put_back(self) -> None:
        """Writes the file anew at its place, which was deleted or moved; it is not to be appended to afterwards.

        Raises:
            CarrlError: the disk refuses it.
        """
        self._file.seek(0)
        write_whole(self._path, self._file.read().encode())

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
