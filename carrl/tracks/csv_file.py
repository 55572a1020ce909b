"""CSV files of a centreline and its widths, as in the TUM racetrack database, and the dialects that others write.

Shapes: `P` points.
"""

import csv
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from carrl.errors import TrackError
from carrl.files import read_whole, write_whole
from carrl.tracks.centreline import MAX_COORDINATE, MAX_FILE_BYTES, MIN_POINTS, MOST_POINTS, Centreline, without_repeats

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
ALSO_CALLED = {
    "x_m": ("x_ref", "x_center", "x_centre", "center_x", "centre_x", "pos_x"),
    "y_m": ("y_ref", "y_center", "y_centre", "center_y", "centre_y", "pos_y"),
    "w_tr_right_m": ("width_right", "right_width", "w_right", "track_width_right", "width_tr_right"),
    "w_tr_left_m": ("width_left", "left_width", "w_left", "track_width_left", "width_tr_left"),
}
"""Other tools' names of the columns, without the unit that may follow: `_m`, `[m]` or `(m)`."""
DELIMITERS = ";\t,"
"""The first that parts a line into as many cells as there are columns is taken, or else blanks."""
MOST_COMMENTS, MOST_NAMES = 1000, 256
"""Of a file, and the names that are looked at in each line that may be its header."""
_HEADER = f"'# {','.join(COLUMNS)}'"

Row = tuple[int, list[str]]
"""The number of the line where a row begins, and its cells."""


class MissingColumnsError(TrackError):
    """A table without some of the columns of a road.

    Attributes:
        columns: those that it lacks.
    """

    def __init__(self, message: str, columns: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.columns = tuple(columns)


def write_csv(path: Path, centreline: Centreline) -> None:
    """Writes a file that `read_csv` reads back to a micrometre, whole or not at all.

    Raises:
        TrackError: it cannot be written there.
    """
    table = np.column_stack([centreline.points, centreline.width_right, centreline.width_left])
    rows = [",".join(f"{value:.6f}" for value in row) for row in table.tolist()]
    write_whole(path, "\n".join([f"# {','.join(COLUMNS)}", *rows, ""]).encode(), TrackError)


def read_csv(path: Path) -> Centreline:
    """Reads a centreline file with the header `# x_m,y_m,w_tr_right_m,w_tr_left_m`, or four columns of these without.

    Columns may stand in any order, be called as in other tools, and have others beside them. Cells are parted by
    semicolons, tabs, commas or blanks; lines that begin with # are comments, of which one may be the header. A last
    point that repeats the first is dropped, and so are points that repeat the one before.

    Raises:
        TrackError: the file is not such a table, or a value in it cannot be a road's.
    """
    return centreline_of(path, read_columns(path, COLUMNS).numbers)


class Columns(NamedTuple):
    """Columns of a file.

    Attributes:
        numbers: [P, C].
        has_header: whether a header told which columns they are.
    """

    numbers: np.ndarray
    has_header: bool


def read_columns(path: Path, columns: Sequence[str]) -> Columns:
    """Reads those columns of a file that are called so, or as in `ALSO_CALLED`, or all without a header.

    Raises:
        MissingColumnsError: it lacks one of the columns.
        TrackError: the file is not such a table, or a value in it cannot be a road's.
    """
    comments, rows = _read_rows(path)
    first = next((index for index, (_, row) in enumerate(rows) if any(map(_is_number, row[:MOST_NAMES]))), len(rows))
    order, has_header = _order(path, [*rows[:first], *comments], rows[first:], columns)
    numbers = [_read_numbers(path, line, row, order, columns) for line, row in rows[first:]]
    return Columns(np.array(numbers).reshape(-1, len(columns)), has_header)


def centreline_of(path: Path, table: np.ndarray) -> Centreline:
    """The centreline with x, y and the widths to the right and to the left in the columns of a table [P, 4], m.

    Raises:
        TrackError: it has too few points.
    """
    table, repeats = without_repeats(table)
    if len(table) < MIN_POINTS:
        raise TrackError(f"track '{path.name}': {len(table)} points; a closed road needs at least {MIN_POINTS}")
    return Centreline(points=table[:, :2], width_right=table[:, 2], width_left=table[:, 3], repeats=repeats)


def _read_rows(path: Path) -> tuple[list[Row], list[Row]]:
    """The comments, each a row of its own names, and the other rows that are not blank."""
    comments: list[Row] = []
    rows: list[Row] = []
    try:
        text = read_whole(path, MAX_FILE_BYTES, f"track '{path.name}'", TrackError).decode("utf-8-sig")
        if text.lstrip().startswith(("{", "<")):
            raise TrackError(f"track '{path.name}': this is JSON or XML; name it .geojson, .xml or .xodr")
        delimiter, line = _delimiter_of(text), 1
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
        for row in reader:
            content = delimiter.join(row).strip()
            if content.startswith("#"):
                comments.append((line, _parted(content[: 40 * MOST_NAMES].lstrip("# "), delimiter)))
            elif content.strip(delimiter).strip():
                rows.append((line, row if delimiter == "," else [cell.replace(",", ".") for cell in row]))
            if len(rows) > MOST_POINTS + 2 or len(comments) > MOST_COMMENTS:
                raise TrackError(
                    f"track '{path.name}': more than {MOST_POINTS} points or {MOST_COMMENTS} comments; leave out some"
                )
            line = reader.line_num + 1  # A quoted cell may hold line breaks, so rows are not lines.
    except (UnicodeDecodeError, csv.Error):
        raise TrackError(f"track '{path.name}': this is not a CSV text file") from None
    if not rows and not comments:
        raise TrackError(f"track '{path.name}': the file is empty; its first line must be {_HEADER}")
    return comments, rows


def _delimiter_of(text: str) -> str:
    """What parts the cells of the first line, comments aside, that has as many of them as there are columns."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    found = (each for line in lines for each in DELIMITERS if line.count(each) >= len(COLUMNS) - 1)
    return next(found, " " if lines and " " in lines[-1].strip() else ",")


def _parted(comment: str, delimiter: str) -> list[str]:
    """A comment as the names of a header, whatever parts them: not always what parts the numbers.

    Words that only blanks part, where other things part the numbers, are a header if a column is called like one.
    """
    if re.search(r"[;,\t]", comment):
        return re.split(r"[;,\t]", comment)
    words = comment.split()
    return words if delimiter == " " or _find(words, COLUMNS) != [None] * len(COLUMNS) else [comment]


def _order(path: Path, headers: list[Row], rows: list[Row], columns: Sequence[str]) -> tuple[list[int], bool]:
    """Where the columns stand, and whether a header says so.

    Raises:
        MissingColumnsError: no header has them all, and there are not just so many without one.
    """
    headers = [(line, names[:MOST_NAMES]) for line, names in headers[:MOST_COMMENTS]]
    found = [_find(names, columns) for _, names in headers]
    best = min(range(len(found)), key=lambda index: found[index].count(None), default=None)
    if best is not None and None not in found[best]:
        return [index for index in found[best] if index is not None], True
    if best is None or found[best].count(None) == len(columns):
        cells = [cell for cell in rows[0][1] if cell.strip()] if rows else []
        above = [at for at, (line, _) in enumerate(headers) if rows and line < rows[0][0]]
        others = [at for at in above if _are_names(headers[at][1], len(cells))]
        if not others and len(cells) == len(columns) == len([cell for cell in cells if _is_number(cell)]):
            return list(range(len(columns))), False
        if not others and rows and (best is None or headers[best][0] > rows[0][0]):
            raise MissingColumnsError(
                f"track '{path.name}': there is no header, and line {rows[0][0]} has {len(cells)} columns; only four "
                f"are taken for {', '.join(COLUMNS)} without one, so put {_HEADER} first",
                columns[2:],
            )
        best = others[0] if others else 0
    line, names = headers[best]
    missing = [column for column, index in zip(columns, found[best], strict=True) if index is None]
    raise MissingColumnsError(
        f"track '{path.name}': the header in line {line} has no column {', '.join(missing)}; it has "
        f"{_cut(', '.join(name.strip() for name in names))}, and must have {_HEADER}",
        missing,
    )


def _are_names(cells: Sequence[str], count: int) -> bool:
    """Whether these are the names of so many columns, of other tools or in other units, which CarRL does not know."""
    return len([cell for cell in cells if cell.strip()]) == count > 1 and not any(map(_is_number, cells))


def _find(names: list[str], columns: Sequence[str]) -> list[int | None]:
    """Where each of the columns stands in a header, by any of its names."""
    header = [_plain(name) for name in names]
    wanted = [(_plain(column), *ALSO_CALLED.get(column, ())) for column in columns]
    return [next((header.index(name) for name in each if name in header), None) for each in wanted]


def _plain(name: str) -> str:
    """A column's name in small letters, without blanks and unit."""
    return re.sub(r"_?(\[m\]|\(m\)|_m)$", "", re.sub(r"[\s-]+", "_", name.strip(" #\t").lower()))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _cut(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."


def _read_numbers(path: Path, line: int, row: list[str], order: list[int], columns: Sequence[str]) -> list[float]:
    numbers = []
    for name, index in zip(columns, order, strict=True):
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
