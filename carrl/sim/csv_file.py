"""CSV files of a centreline and its widths, as in the TUM racetrack database.

Shapes: `P` points.
"""

import csv
import io
import math
from pathlib import Path

import numpy as np

from carrl.errors import TrackError
from carrl.files import write_whole
from carrl.sim.centreline import (
    MAX_COORDINATE,
    MIN_POINTS,
    MIN_STEP,
    MOST_POINTS,
    Centreline,
    drop_closing_point,
    repeated_point,
)
from carrl.sim.file_content import read_content

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")


def write_csv(path: Path, centreline: Centreline) -> None:
    """Writes a file that `read_csv` reads back to a micrometre, whole or not at all.

    Raises:
        TrackError: it cannot be written there.
    """
    table = np.column_stack([centreline.points, centreline.width_right, centreline.width_left])
    rows = [",".join(f"{value:.6f}" for value in row) for row in table.tolist()]
    write_whole(path, "\n".join([f"# {','.join(COLUMNS)}", *rows, ""]).encode(), TrackError)


def read_csv(path: Path) -> Centreline:
    """Reads a centreline file with the header `# x_m,y_m,w_tr_right_m,w_tr_left_m`.

    Columns may stand in any order, and others may stand beside them. A last point that repeats the first is dropped.

    Raises:
        TrackError: the file is not such a table, or a value in it cannot be a road's.
    """
    (_, names), *rows = _read_rows(path)
    header = [name.strip().lower() for name in ",".join(names).lstrip("# ").split(",")]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise TrackError(
            f"track '{path.name}': the first line has no column {', '.join(missing)}; "
            f"it must be '# {','.join(COLUMNS)}'"
        )
    order = [header.index(name) for name in COLUMNS]
    table = np.array([_read_numbers(path, line, row, order) for line, row in rows])
    table = drop_closing_point(table)
    if len(table) < MIN_POINTS:
        raise TrackError(f"track '{path.name}': {len(table)} points; a closed road needs at least {MIN_POINTS}")
    first = repeated_point(table[:, :2])
    if first is not None:
        lines = f"{rows[first][0]} and {rows[(first + 1) % len(table)][0]}"
        raise TrackError(
            f"track '{path.name}': lines {lines} repeat a point, or nearly; keep one of the two, "
            f"since points must stand at least {MIN_STEP} m apart"
        )
    return Centreline(points=table[:, :2], width_right=table[:, 2], width_left=table[:, 3])


def _read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """The rows that are not blank, each with the number of the line where it begins."""
    rows, line = [], 1
    content = read_content(path)
    try:
        reader = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""))
        for row in reader:
            if "".join(row).strip():
                rows.append((line, row))
            if len(rows) > MOST_POINTS + 2:
                raise TrackError(f"track '{path.name}': more than {MOST_POINTS} points; leave out some")
            line = reader.line_num + 1  # A quoted cell may hold line breaks, so rows are not lines.
    except (UnicodeDecodeError, csv.Error):
        raise TrackError(f"track '{path.name}': this is not a CSV text file") from None
    if not rows:
        raise TrackError(f"track '{path.name}': the file is empty; its first line must be '# {','.join(COLUMNS)}'")
    return rows


def _read_numbers(path: Path, line: int, row: list[str], order: list[int]) -> list[float]:
    numbers = []
    for name, index in zip(COLUMNS, order, strict=True):
        cell = row[index].strip() if index < len(row) else ""
        try:
            number = float(cell.replace("_", "?"))  # Python would read 4_0 as 40.
        except ValueError:
            raise TrackError(
                f"track '{path.name}': line {line}: {name} is {cell[:40]!r}; it must be a number"
            ) from None
        if not math.isfinite(number) or abs(number) > MAX_COORDINATE:
            raise TrackError(
                f"track '{path.name}': line {line}: {name} is {cell[:40]}; it must be a finite number of metres "
                f"of at most {MAX_COORDINATE:.0f}, so move a far-off track to the origin"
            )
        if name.startswith("w_tr") and number <= 0:
            raise TrackError(f"track '{path.name}': line {line}: {name} is {number} m; widths must be positive")
        numbers.append(number)
    return numbers
