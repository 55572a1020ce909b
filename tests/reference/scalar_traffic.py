"""An independent, slow answer to what rays see of cars and how cars touch, one ray and one moment at a time."""

import math

import numpy as np
import shapely

from tests.reference.scalar_rays import ray_distance


def corners(x, y, heading, length, width):
    """Of a rectangle about its middle, counter-clockwise."""
    cos, sin = math.cos(heading), math.sin(heading)
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return [
        (x + cos * a * length / 2 - sin * b * width / 2, y + sin * a * length / 2 + cos * b * width / 2)
        for a, b in signs
    ]


def sides(pose, length, width):
    """Of a car at a pose, as walls that rays meet."""
    points = corners(*pose, length, width)
    return list(zip(points, points[1:] + points[:1], strict=True))


def is_inside(x, y, pose, length, width):
    """Whether a point is in a car at a pose."""
    return shapely.Polygon(corners(*pose, length, width)).contains(shapely.Point(x, y))


def car_distance(x, y, angle, cars, max_range):
    """The distance along a ray to the first car, each given by its sides; `max_range` if it meets none."""
    return min(ray_distance(x, y, angle, own, max_range) for own in cars)


def gap_between(one, two, length, width):
    """The distance between two cars at poses; below 0 if they overlap, by the root of the area."""
    first, second = (shapely.Polygon(corners(*pose, length, width)) for pose in (one, two))
    area = first.intersection(second).area
    return -math.sqrt(area) if area > 0 else first.distance(second)


def overlaps(pairs, length, width):
    """By how much the cars of each pair overlap, poses [N, 2, 3]: the root of the area, [N], m."""
    first, second = (
        shapely.polygons([corners(*pose, length, width) for pose in pairs[:, car].tolist()]) for car in (0, 1)
    )
    return np.sqrt(shapely.area(shapely.intersection(first, second)))


def least_gap(ways, shares, length, width, moments=100):
    """The least gap of two cars that drive straight ways (begin pose, end pose), each a share of it, then stand."""
    least = math.inf
    for moment in range(moments + 1):
        time, poses = moment / moments, []
        for (begin, end), share in zip(ways, shares, strict=True):
            done = min(time, share)
            poses.append((begin[0] + done * (end[0] - begin[0]), begin[1] + done * (end[1] - begin[1]), end[2]))
        least = min(least, gap_between(*poses, length, width))
    return least
