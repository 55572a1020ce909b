"""Waypoint files of AWS DeepRacer tracks: a NumPy array of the middle and both borders of a road.

Shapes: `N` rows of the file, `P` points.
"""

import io
import math
import tokenize
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from carrl.errors import TrackError
from carrl.files import write_whole
from carrl.tracks.borders import cut_abreast
from carrl.tracks.centreline import MAX_COORDINATE, MIN_POINTS, MOST_POINTS, without_repeats
from carrl.tracks.file_content import read_content

COLUMNS = ("centre x", "centre y", "inner x", "inner y", "outer x", "outer y")


class Waypoints(NamedTuple):
    """A road as its file gives it, in driving order.

    Attributes:
        centre: of the road, [P, 2], m.
        left: the left wall beside each of its points, [P, 2], m.
        right: the right wall, [P, 2], m.
        repeats: how many rows were left out, since they repeated the one before.
    """

    centre: np.ndarray
    left: np.ndarray
    right: np.ndarray
    repeats: int


def read_waypoints(path: Path) -> Waypoints:
    """Reads the centreline and both walls of a road.

    The inner border is the left one or the right one, depending on the sense of rotation. A last row that repeats the
    first is dropped, and so are rows that repeat the one before. Borders whose rows do not stand abreast of the
    centre's are cut with its normals.

    Raises:
        TrackError: the file is not such an array, or a value in it cannot be a road's.
    """
    table, repeats = without_repeats(_checked(path, _read_array(path)))
    if len(table) < MIN_POINTS:
        raise TrackError(f"track '{path.name}': {len(table)} points; a closed road needs at least {MIN_POINTS}")
    centre, inner, outer = table[:, 0:2], table[:, 2:4], table[:, 4:6]
    inner_is_left, outer_is_left = _is_left(centre, inner), _is_left(centre, outer)
    if inner_is_left == outer_is_left:
        raise TrackError(
            f"track '{path.name}': both borders lie on the same side of the centre; "
            f"the columns must be {', '.join(COLUMNS)}"
        )
    left, right = (inner, outer) if inner_is_left else (outer, inner)
    return Waypoints(centre, cut_abreast(centre, left, True), cut_abreast(centre, right, False), repeats)


def write_waypoints(path: Path, centre: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    """Writes a road with both walls beside each point, [P, 2] each, m, closed by its first point as those of AWS are.

    Raises:
        TrackError: it cannot be written there.
    """
    way = np.roll(centre, -1, axis=0) - centre
    middle = centre - centre.mean(axis=0)
    is_clockwise = (middle[:, 0] * way[:, 1] - middle[:, 1] * way[:, 0]).sum() < 0
    inner, outer = (right, left) if is_clockwise else (left, right)
    table = np.concatenate([centre, inner, outer], axis=1)
    file = io.BytesIO()
    np.save(file, np.concatenate([table, table[:1]]))
    write_whole(path, file.getvalue(), TrackError)


def _is_left(centre: np.ndarray, border: np.ndarray) -> bool:
    """Whether most of the border lies to the left of the centreline's driving direction."""
    forward, across = np.roll(centre, -1, axis=0) - np.roll(centre, 1, axis=0), border - centre
    return bool((np.sign(forward[:, 0] * across[:, 1] - forward[:, 1] * across[:, 0])).sum() > 0)


def _read_array(path: Path) -> np.ndarray:
    """The array of numbers in a .npy file; never unpickles, and trusts no size that the header claims."""
    content = read_content(path)
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():  # NumPy's of files that Python 2 wrote, which it reads all the same
            warnings.simplefilter("ignore")
            shape, columns_first, kind = read_header(file)
    except (ValueError, SyntaxError, tokenize.TokenError, RecursionError, MemoryError):
        raise TrackError(f"track '{path.name}': this is not a NumPy array file (.npy)") from None
    if kind.kind not in "fiu":
        raise TrackError(f"track '{path.name}': the array holds {kind}; it must hold plain numbers, such as float64")
    if len(shape) != 2 or shape[0] < 0 or shape[1] != len(COLUMNS):
        raise TrackError(
            f"track '{path.name}': the array has the shape {shape}; it must have a row for each point with "
            f"{len(COLUMNS)} columns: {', '.join(COLUMNS)}"
        )
    if shape[0] > MOST_POINTS + 1 and len(content) - file.tell() >= math.prod(shape) * kind.itemsize:
        raise TrackError(f"track '{path.name}': {shape[0]} rows; a track may have at most {MOST_POINTS} points")
    if len(content) - file.tell() < math.prod(shape) * kind.itemsize:
        raise TrackError(f"track '{path.name}': the file ends before its {shape[0]} rows do; copy it again")
    numbers = np.frombuffer(content, kind, math.prod(shape), file.tell())
    with np.errstate(all="ignore"):  # NumPy warns of numbers that are none; the caller refuses them
        return numbers.reshape(shape, order="F" if columns_first else "C").astype(np.float64)


def _checked(path: Path, table: np.ndarray) -> np.ndarray:
    bad = np.argwhere(~(np.abs(table) <= MAX_COORDINATE))
    if len(bad) > 0:
        row, column = bad[0].tolist()
        raise TrackError(
            f"track '{path.name}': row {row + 1}: {COLUMNS[column]} is {table[row, column]:g}; it must be a finite "
            f"number of metres of at most {MAX_COORDINATE:.0f}"
        )
    return table
