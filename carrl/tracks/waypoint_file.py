"""Waypoint files of AWS DeepRacer tracks: a NumPy array of the middle and both borders of a road.

Where a file does not give the borders abreast of the centreline, its normals cut them.

Shapes: `N` rows of the file, `P` points of the centreline and of a border, `K` pairs of a normal and a piece of the
border that meet.
"""

import io
import math
import tokenize
import warnings
from pathlib import Path

import numpy as np
import shapely

from carrl.errors import TrackError
from carrl.files import read_whole, write_whole
from carrl.tracks.bridges import find_crossings, segments_of
from carrl.tracks.centreline import (
    MAX_COORDINATE,
    MAX_FILE_BYTES,
    MIN_POINTS,
    MOST_POINTS,
    Road,
    normals,
    without_repeats,
)

COLUMNS = ("centre x", "centre y", "inner x", "inner y", "outer x", "outer y")
MOST_SKEW = math.radians(20)
"""How far from the normal a point of the border may stand; in 107 of 126 public files it is at most 6 degrees."""
_REACH = 2.0
"""Length of a normal, in largest distances of a border's points from those of the centreline."""
_APART = 0.25
"""How far along the lap a border's point may be from the centreline's that it was given beside, in laps."""


def read_waypoints(path: Path) -> Road:
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
    return Road(centre, cut_abreast(centre, left, True), cut_abreast(centre, right, False), repeats)


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
    content = read_whole(path, MAX_FILE_BYTES, f"track '{path.name}'", TrackError)
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


def is_abreast(centre: np.ndarray, border: np.ndarray) -> bool:
    """Whether each point of a border [P, 2] stands about square to the centreline [P, 2], m, at the same point."""
    square, away = normals(centre), border - centre
    across = np.abs((away * square).sum(axis=1))
    along = np.abs(away[:, 0] * square[:, 1] - away[:, 1] * square[:, 0])
    return bool((along <= math.tan(MOST_SKEW) * across).all())


def cut_abreast(centre: np.ndarray, border: np.ndarray, is_left: bool) -> np.ndarray:
    """Where the normals of a centreline meet a border, in the order of the centreline; unchanged if it stands abreast.

    Args:
        centre: [P, 2], m.
        border: on one side of it, driven the same way round, [P, 2], m.
        is_left: on which side.

    Returns:
        [P, 2], m. Neighbours may coincide, where the normals meet on the way to the border.
    """
    if is_abreast(centre, border):
        return border
    outward = normals(centre) * (1 if is_left else -1)
    reach = _REACH * np.linalg.norm(border - centre, axis=1).max()
    lines = np.asarray(shapely.linestrings(np.stack([centre, centre + reach * outward], axis=1)))
    pairs = find_crossings(
        lines, segments_of(border), lambda one, other: np.abs(_lag(other - one, len(centre))) < _APART
    )
    return _at(border, _steady(_places(pairs, centre, outward, border)))


def _places(pairs: np.ndarray, centre: np.ndarray, outward: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Where the normal of each point meets the border first, [P], in points of the border; between others if nowhere.

    Args:
        pairs: indices of the normals and the pieces of the border that meet, [K, 2].
        centre: [P, 2], m.
        outward: normals of the centreline towards the border, [P, 2].
        border: [P, 2], m.
    """
    count, (row, piece) = len(centre), pairs.T
    way, to_piece = (np.roll(border, -1, axis=0) - border)[piece], border[piece] - centre[row]
    area = _cross(outward[row], way)
    row, piece, way, to_piece, area = (each[area != 0] for each in (row, piece, way, to_piece, area))
    distance, share = _cross(to_piece, way) / area, _cross(to_piece, outward[row]) / area
    order = np.argsort(-distance, kind="stable")  # the nearest last, which then stays
    lag = np.full(count, np.nan)
    lag[row[order]] = (_lag(piece - row, count) * count + share)[order]
    found = np.flatnonzero(np.isfinite(lag))
    if not len(found):  # the border is nowhere near: what the file has is then found to be no road
        return np.arange(count, dtype=np.float64)
    return np.arange(count) + np.interp(np.arange(count), found, lag[found], period=count)


def _steady(places: np.ndarray) -> np.ndarray:
    """The places [P] without any that runs back: half-way between the last one before and the first one behind."""
    count = len(places)
    laps = np.concatenate([places - count, places, places + count])
    forwards, backwards = np.maximum.accumulate(laps), np.minimum.accumulate(laps[::-1])[::-1]
    return np.asarray((forwards + backwards)[count : 2 * count] / 2)


def _at(border: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The points of a closed line at places between its points: [P, 2] and [P] to [P, 2]."""
    before = np.floor(places).astype(int)
    share, count = (places - before)[:, None], len(border)
    return np.asarray((1 - share) * border[before % count] + share * border[(before + 1) % count])


def _lag(steps: np.ndarray, count: int) -> np.ndarray:
    """Steps along a closed line of `count` points as the shorter way round, in laps in [-0.5, 0.5)."""
    return (steps / count + 0.5) % 1 - 0.5


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
