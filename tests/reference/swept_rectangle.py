"""An independent, slow answer to how far a moving rectangle stays away from walls, by Shapely's polygons."""

from shapely import LineString, MultiLineString, MultiPoint, affinity, box


def swept_rectangle(begin, end, heading, length, width):
    """All that a rectangle covers on its straight way, with this heading, rad: a convex polygon."""
    corners = affinity.rotate(box(-length / 2, -width / 2, length / 2, width / 2), heading, (0, 0), use_radians=True)
    placed = [affinity.translate(corners, *point) for point in (begin, end)]
    return MultiPoint([corner for each in placed for corner in each.exterior.coords]).convex_hull


def swept_distance(begin, end, heading, length, width, walls):
    """The least distance between what it covers and any wall; below 0 the more, the deeper the wall is inside."""
    area, lines = swept_rectangle(begin, end, heading, length, width), MultiLineString(walls)
    if not area.intersects(lines):
        return area.distance(lines)
    inside = lines.intersection(area)
    lengthy = [part for part in getattr(inside, "geoms", [inside]) if len(part.coords) > 1]
    points = [point for part in lengthy for point in LineString(part.coords).segmentize(0.01).coords]
    return -max((area.exterior.distance(MultiPoint([point])) for point in points), default=0.0)
