"""A table as Apache Parquet, with units and meanings of its columns and what the log says of its run."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from carrl.errors import CarrlError
from carrl.export.table.table_columns import TableColumn, table_columns
from carrl.log.codec import Columns, Selection
from carrl.log.log_file import ATTACHMENT, CHECKSUM
from carrl.log.reader import Log

GROUP_ROWS = 2**17
"""The least number of rows in a group, the last one apart: large enough to be read fast, and held in memory at once."""


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
