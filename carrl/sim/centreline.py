"""A road given by its centreline and its widths, and the CSV files that hold one.

Shapes: `P` points.
"""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carrl.errors import TrackError

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
MAX_FILE_BYTES = 16 * 2**20
MIN_POINTS = 3
MIN_STEP = 0.01
"""Least distance between neighbouring points, m; together with MAX_COORDINATE it keeps them apart in float32."""
MAX_COORDINATE = 1e5


@dataclass(frozen=True)
class Centreline:
    """A closed line in driving order; the last point joins the first.

    Attributes:
        points: [P, 2], float64, m.
        width_right: from the centreline to the right wall, [P], m.
        width_left: from the centreline to the left wall, [P], m.
    """

    points: np.ndarray
    width_right: np.ndarray
    width_left: np.ndarray

    def walls(self) -> tuple[np.ndarray, np.ndarray]:
        """The left and the right wall, [P, 2] each, m: the points moved sideways by the widths."""
        tangent = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        to_left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return self.points + to_left * self.width_left[:, None], self.points - to_left * self.width_right[:, None]


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
    if len(table) > 1 and np.linalg.norm(table[0, :2] - table[-1, :2]) < MIN_STEP:
        table = table[:-1]
    if len(table) < MIN_POINTS:
        raise TrackError(f"track '{path.name}': {len(table)} points; a closed road needs at least {MIN_POINTS}")
    steps = np.linalg.norm(np.roll(table[:, :2], -1, axis=0) - table[:, :2], axis=1)
    if (steps < MIN_STEP).any():
        first = int(steps.argmin())
        lines = f"{rows[first][0]} and {rows[(first + 1) % len(table)][0]}"
        raise TrackError(
            f"track '{path.name}': lines {lines} repeat a point, or nearly; keep one of the two, "
            f"since points must stand at least {MIN_STEP} m apart"
        )
    return Centreline(points=table[:, :2], width_right=table[:, 2], width_left=table[:, 3])


def _read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """The rows that are not blank, each with the number of the line where it begins."""
    rows, line = [], 1
    try:
        with path.open("rb") as file:
            content = file.read(MAX_FILE_BYTES + 1)
        if len(content) > MAX_FILE_BYTES:
            raise TrackError(f"track '{path.name}': the file is too large; it may have at most {MAX_FILE_BYTES} bytes")
        reader = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""))
        for row in reader:
            if "".join(row).strip():
                rows.append((line, row))
            line = reader.line_num + 1  # A quoted cell may hold line breaks, so rows are not lines.
    except IsADirectoryError:
        raise TrackError(f"track '{path}': this is a folder; name a CSV file in it") from None
    except (UnicodeDecodeError, csv.Error):
        raise TrackError(f"track '{path.name}': this is not a CSV text file") from None
    except OSError as error:
        raise TrackError(f"track '{path}': cannot be read: {error.strerror}") from error
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
