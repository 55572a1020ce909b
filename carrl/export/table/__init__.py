"""A log's transitions as a table in one file, for pandas, polars, DuckDB, NumPy or a spreadsheet."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from carrl.errors import CarrlError, LogError
from carrl.export.table.csv_file import write_csv
from carrl.export.table.npz_file import write_npz
from carrl.export.table.parquet_file import write_parquet
from carrl.files import appearing_whole
from carrl.log.codec import Selection
from carrl.log.reader import Log

Writer: TypeAlias = Callable[[Path, Log, Selection], int]

WRITERS: dict[str, Writer] = {".csv": write_csv, ".parquet": write_parquet, ".npz": write_npz}
"""By the ending of the file's name; each writes the transitions selected and returns how many there are."""


def write_table(path: str | Path, log: Log, selection: Selection) -> int:
    """Writes the selected transitions, whole or not at all, in the format that the name ends in.

    Args:
        path: the file, whose name ends in .csv, .parquet or .npz; an older one is replaced.
        log: where the transitions are.
        selection: which of them.

    Returns:
        How many there are, at least one.

    Raises:
        CarrlError: the file cannot be written, or has another ending, or a package for it is not installed.
        LogError: no transition is selected.
        DamagedLogError: the log is not intact.
    """
    path = Path(path)
    write = WRITERS.get(path.suffix.lower())
    if write is None:
        raise CarrlError(f"'{path}' is no name of a table; it must end in {', '.join(WRITERS)}")
    with appearing_whole(path) as partial:
        count = write(partial, log, selection)
        if not count:
            raise LogError(f"log '{log.path}': has no such transition; carrl log info and ls tell which it has")
    return count
