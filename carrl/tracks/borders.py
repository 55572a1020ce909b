"""Cuts the borders of a road with the normals of its centreline, where a file does not give them abreast of it.

Shapes: `P` points of the centreline and of a border, `K` pairs of a normal and a piece of the border that meet.
"""

import math

import numpy as np
import shapely

from carrl.tracks.centreline import normals
from carrl.tracks.crossings import find_crossings, segments_of

MOST_SKEW = math.radians(20)
"""How far from the normal a point of the border may stand; in 107 of 126 public files it is at most 6 degrees."""
_REACH = 2.0
"""Length of a normal, in largest distances of a border's points from those of the centreline."""
_APART = 0.25
"""How far along the lap a border's point may be from the centreline's that it was given beside, in laps."""


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
