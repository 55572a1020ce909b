"""CSV files of roads and of racelines: lines that somebody proposes to drive, with or without the road around them.

Shapes: `P` points of a line.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from carrl.errors import TrackError, shown
from carrl.tracks.centreline import MIN_POINTS, Road, without_repeats
from carrl.tracks.csv_file import COLUMNS, MissingColumnsError, centreline_of, read_columns

LINE = ("x_m", "y_m")
ON_NORMALS = (*COLUMNS[:2], "x_normvec_m", "y_normvec_m", "alpha_m")
"""A raceline as in TUM's local planner: `alpha_m` along a unit vector from a point of the centreline."""
MOST_WIDTH = 1e4


def read(path: Path, width: float | None = None) -> Road:
    """The road in a CSV file, with the raceline in it, or in a file beside it, as its reference line.

    A file of a raceline alone, such as TUM's `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2`, has no widths:
    with a width given, the raceline is the middle of the road.

    Args:
        path: of the file.
        width: of the road, m, for a file without widths.

    Raises:
        TrackError: the file is no such table, it lacks widths, or it has them and `width` is given.
    """
    notes, reference = [], None
    try:
        table, has_header = read_columns(path, COLUMNS)
    except MissingColumnsError as no_road:
        line = _read(path, LINE) if no_road.columns == COLUMNS[2:] else None
        if line is None or len(line) < MIN_POINTS:
            raise
        if width is None:
            raise TrackError(f"{no_road}; to take its line for the middle of a road, give track.width") from None
        table = np.column_stack([line, np.full((len(line), 2), _checked_width(path, width) / 2)])
        reference = line
        notes.append(f"a line without widths, taken for the middle of a road {width:g} m wide")
    else:
        if width is not None:
            raise TrackError(f"track '{path.name}': width is {shown(width)}, but this file has widths of its own")
        if not has_header:
            notes.append(f"four columns without a header, read as {', '.join(COLUMNS)}")
        on_normals = _read(path, ON_NORMALS)
        if on_normals is not None:
            reference = on_normals[:, :2] + on_normals[:, 2:4] * on_normals[:, 4:]
            notes.append("reference line from alpha_m")
    if reference is None:
        reference, found = reference_beside(path)
        notes += found
    return replace(centreline_of(path, table).road(), notes=tuple(notes), reference=without_closing(reference))


def reference_beside(path: Path) -> tuple[np.ndarray | None, list[str]]:
    """The raceline that lies beside a road's file, [P, 2], m, or None, and a note of it.

    It is NAME_raceline.csv, as in f1tenth_racetracks, or ../racelines/NAME.csv, as in TUM's database.
    """
    name = path.stem
    for ending in ("_centerline", "_centreline", "_map"):
        name = name.removesuffix(ending)
    candidates = [path.with_name(f"{name}_raceline.csv")]
    if path.parent.name == "tracks":
        candidates.append(path.parent.parent / "racelines" / f"{path.stem}.csv")
    beside = next((each for each in candidates if os.path.isfile(each)), None)
    if beside is None:
        return None, []
    line = _read(beside, LINE)
    if line is None or len(line) < MIN_POINTS:
        return None, [f"no reference line, since {beside.name} beside it cannot be read as one"]
    return line, [f"reference line from {beside.name}"]


def without_closing(line: np.ndarray | None) -> np.ndarray | None:
    """A closed line [P, 2] without repeated points."""
    return None if line is None else without_repeats(line)[0]


def _read(path: Path, columns: tuple[str, ...]) -> np.ndarray | None:
    """The columns [P, C] of a file that has them all."""
    try:
        return read_columns(path, columns).numbers
    except TrackError:
        return None


def _checked_width(path: Path, width: float) -> float:
    if not isinstance(width, int | float) or isinstance(width, bool) or not 0 < width <= MOST_WIDTH:
        raise TrackError(f"track '{path.name}': width is {shown(width)}; it must be a number of metres above 0")
    return float(width)
