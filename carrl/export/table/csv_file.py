"""A table as CSV, as RFC 4180 has it but for the ends of the lines.

Numbers are the shortest decimal ones that, read as the column's own type, are the same bit for bit; truth is `true` and
`false`, and what is no number is `nan`, `inf` or `-inf`. Shape letters: `T` transitions.
"""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carrl.export.table.table_columns import table_columns
from carrl.log.codec import Selection
from carrl.log.reader import Log


def write_csv(path: Path, log: Log, selection: Selection) -> int:
    """Writes a heading and a line for each selected transition, holding some thousands at a time; returns how many."""
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
