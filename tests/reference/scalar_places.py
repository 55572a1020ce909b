"""Where a car is along its road, one car and one point at a time, in plain Python.

The road is drawn so finely that no segment needs a projection: the nearest of many points counts.
"""

import bisect
import math
from collections.abc import Sequence

Point = tuple[float, float]


def stations_of(points: Sequence[Point]) -> list[float]:
    """The way along the closed line to each of its points, and at the end its length, m."""
    stations = [0.0]
    for begin, end in zip(points, [*points[1:], points[0]], strict=True):
        stations.append(stations[-1] + math.dist(begin, end))
    return stations


def nearest_near(
    points: Sequence[Point], position: Point, last: float, reach: float, spacing: float = 0.01
) -> tuple[float, float]:
    """The station of the line's point nearest to a position, no further than the reach from the last, and how far off.

    Args:
        points: of the closed line, m.
        position: m.
        last: station, m.
        reach: to either side of it, m.
        spacing: between two points that are looked at, m.
    """
    stations = stations_of(points)
    length = stations[-1]
    best, least = last, math.inf
    for index in range(-math.ceil(reach / spacing), math.ceil(reach / spacing) + 1):
        station = (last + index * spacing) % length
        distance = math.dist(_point_at(points, stations, station), position)
        if distance < least:
            best, least = station, distance
    return best, least


def _point_at(points: Sequence[Point], stations: Sequence[float], station: float) -> Point:
    segment = min(bisect.bisect_right(stations, station) - 1, len(points) - 1)
    begin, end = points[segment], points[(segment + 1) % len(points)]
    share = (station - stations[segment]) / (stations[segment + 1] - stations[segment])
    return begin[0] + share * (end[0] - begin[0]), begin[1] + share * (end[1] - begin[1])
