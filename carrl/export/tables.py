"""A log's transitions as a table in one file, for pandas, polars, DuckDB, NumPy or a spreadsheet.

A table has one value in each of its cells: a column of the log with several values a row is several of the table's.
Shape letters: `T` transitions.
"""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from carrl.errors import CarrlError, LogError
from carrl.files import appearing_whole
from carrl.log.codec import Columns, Selection
from carrl.log.log_file import ATTACHMENT, CHECKSUM
from carrl.log.reader import Log
from carrl.log.scene import STATE_UNITS
from carrl.log.schema import Column

Writer: TypeAlias = Callable[[Path, Log, Selection], int]

GROUP_ROWS = 2**17
"""The least number of rows in a group, the last one apart: large enough to be read fast, and held in memory at once."""
_UNITS = {
    **{f"{column}_{name}": unit for column in ("state", "next_state") for name, unit in STATE_UNITS.items()},
    "time_ns": "ns",
}


@dataclass(frozen=True)
class TableColumn:
    """One column of the table.

    Attributes:
        name: its heading, such as `state_x`.
        source: the log's column that it is taken from.
        index: of the value within a transition's row of values; None if the log has one value for each transition.
    """

    name: str
    source: Column
    index: int | None

    @property
    def unit(self) -> str:
        """In which its values are; 1 for plain numbers."""
        return _UNITS.get(self.name, "1")

    def values(self, columns: Mapping[str, NDArray[np.generic]]) -> NDArray[np.generic]:
        """Its values in these columns of a log, [T]."""
        found = columns[self.source.name]
        return found if self.index is None else found[:, self.index]


def table_columns(log: Log) -> list[TableColumn]:
    """The columns of a log's table, in the order of the log's.

    A column of one value keeps its name; one of several has its entry's name after its own: `state_x`,
    `action_value_left`, `reward_gate`; or its entry's number where entries have no names: `observation_0`.
    """
    return [table_column for column in log.schema.columns for table_column in _columns_of(column)]


def _columns_of(column: Column) -> list[TableColumn]:
    if column.shape == ():
        return [TableColumn(column.name, column, None)]
    names: Sequence[str] = column.entries
    if column.width == 1 and not names:
        return [TableColumn(column.name, column, 0)]
    if len(set(names)) != column.width:
        names = [str(index) for index in range(column.width)]
    stem = "reward" if column.name == "reward_terms" else column.name
    return [TableColumn(f"{stem}_{name}", column, index) for index, name in enumerate(names)]


def write_csv(path: Path, log: Log, selection: Selection) -> int:
    """Writes a heading and a line for each selected transition, holding some thousands at a time; returns how many.

    Numbers are the shortest decimal ones that, read as the column's own type, are the same bit for bit; truth is `true`
    and `false`, and what is no number is `nan`, `inf` or `-inf`.
    """
    columns, count = table_columns(log), 0
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow([column.name for column in columns])
        for batch in log.batches(selection):
            rows = zip(*(_texts(column.values(batch)) for column in columns), strict=True)
            file.writelines(",".join(row) + "\n" for row in rows)  # no number needs quotes
            count += len(batch["action"])
    return count


def _texts(values: NDArray[np.generic]) -> list[str]:
    """The values, [T], as they are to be written."""
    if values.dtype == np.bool_:
        return np.where(values, "true", "false").tolist()
    texts: list[str] = values.astype(np.dtypes.StringDType()).tolist()
    return texts


def write_npz(path: Path, log: Log, selection: Selection) -> int:
    """Writes the selected transitions, all of which are in memory then, compressed; returns how many."""
    columns = log.columns(selection)
    with path.open("wb") as file:  # given a name, NumPy appends an ending
        np.savez_compressed(file, allow_pickle=False, **columns)
    return len(columns["action"])


def write_parquet(path: Path, log: Log, selection: Selection) -> int:
    """Writes a row for each selected transition; returns how many.

    Raises:
        CarrlError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise CarrlError("Parquet needs pyarrow, which is not installed; pip install 'carrl[export]'") from error
    columns, count = table_columns(log), 0
    schema = pa.schema([_field(pa, column) for column in columns], metadata=_run_metadata(log))
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for batches in _groups(log.batches(selection)):
            arrays = [
                pa.chunked_array([pa.array(column.values(batch)) for batch in batches], field.type)
                for column, field in zip(columns, schema, strict=True)
            ]
            table = pa.table(arrays, schema=schema)
            writer.write_table(table, row_group_size=len(table))
            count += len(table)
    return count


def _field(pa: Any, column: TableColumn) -> Any:
    metadata = {"unit": column.unit, "meaning": column.source.meaning}
    return pa.field(column.name, pa.from_numpy_dtype(column.source.dtype), nullable=False, metadata=metadata)


def _run_metadata(log: Log) -> dict[str, str]:
    """The log's metadata without what only helps to read the log."""
    return {
        key: value
        for key, value in log.metadata.items()
        if key != CHECKSUM and not key.startswith(("column.", ATTACHMENT))
    }


def _groups(batches: Iterator[Columns]) -> Iterator[list[Columns]]:
    """Batches that are written together."""
    group: list[Columns] = []
    rows = 0
    for batch in batches:
        group.append(batch)
        rows += len(batch["action"])
        if rows >= GROUP_ROWS:
            yield group
            group, rows = [], 0
    if group:
        yield group


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
