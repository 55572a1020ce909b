"""Tracks of TORCS and Speed Dreams: XML files of straights and curves in driving order.

Shapes: `P` points of the centreline. Arc length counts from the start line, m.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from carrl.errors import TrackError, shown
from carrl.tracks.centreline import MAX_COORDINATE, MIN_POINTS, MOST_POINTS, Road, drop_closing_point, without_repeats
from carrl.tracks.reference_line import Piece
from carrl.tracks.xml_file import read_xml

UNITS = {
    **dict.fromkeys(("m", "rad", ""), 1.0),
    **dict.fromkeys(("feet", "ft"), 0.304801),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **{"km": 1000.0, "cm": 0.01, "mm": 0.001, "deg": math.pi / 180},
}
"""Of lengths and angles, in metres and radians, as TORCS has them: its foot is 1 um longer than the real one."""
MAX_LENGTH = 1e5
"""Of the road, m; the longest track of TORCS has 22 km."""
LEAST = 1e-6
"""Of a length, m, and of an angle, rad."""
MOST_STRETCHES, MOST_STEPS = 20_000, 1000
"""Straights and arcs of a road, and arcs of one segment; of TORCS's 38 tracks at most 930 and 92."""
WALLS = ("road", "barriers")


def read(path: Path, walls: str = WALLS[0]) -> Road:
    """The road of a track; heights and banking are left out, and so are the pits.

    Args:
        path: of the XML file.
        walls: `road` for walls at the edges of the road, which TORCS's `track` sensors see; `barriers` for those that
            stop a car there, beyond grass and sand.

    Raises:
        TrackError: the file is no such track, or its road does not come back to its start.
    """
    if walls not in WALLS:
        raise TrackError(f"track '{path.name}': walls is {shown(walls)}; it must be {' or '.join(WALLS)}")
    return _Reader(path, read_xml(path)).road(walls == "barriers")


class _Stretch(NamedTuple):
    """A straight or an arc.

    Attributes:
        length: m.
        curvature: 1/m, positive to the left.
        left: how far the left wall is from the centreline where it begins and where it ends, m.
        right: likewise.
    """

    length: float
    curvature: float
    left: tuple[float, float]
    right: tuple[float, float]

    def begin_at(self, x: float, y: float, heading: float) -> Piece:
        """It as a line that begins at a place, m, with a heading, rad."""
        return Piece(x, y, heading, self.length, (self.curvature, self.curvature))


class _Side:
    """What lies beside the road on one side, from segment to segment: what a segment does not say stays as before."""

    def __init__(self, name: str, main: Element, reader: "_Reader") -> None:
        self._name, self._reader = name, reader
        self._end = self._number(main, "Side", "width", 0.0)
        self._border, self._style = 0.0, "plan"
        self._read_border(main)

    def widths(self, segment: Element) -> tuple[float, float]:
        """From the road's edge to the barrier, where the segment begins and where it ends, m."""
        begin = self._number(segment, "Side", "start width", self._end)
        self._end = self._number(segment, "Side", "end width", self._number(segment, "Side", "width", begin))
        self._read_border(segment)
        if self._style == "wall" and self._border > 0 and max(begin, self._end) > 0:
            return 0.0, 0.0  # TORCS makes a wall of it only where a side lies behind
        return self._border + begin, self._border + self._end

    def _read_border(self, section: Element) -> None:
        self._border = self._number(section, "Border", "width", self._border)
        of_border = self._section(section, "Border")
        if of_border is not None:
            self._style = _text(of_border, "style", self._style)
        else:
            self._style = _text(section, f"{self._name[0].lower()}border style", self._style)

    def _number(self, section: Element, part: str, name: str, default: float) -> float:
        """Of a section of its own, as in version 4 of the format, or else of a name such as `lside width`, as in 3."""
        of_part = self._section(section, part)
        if of_part is not None:
            value = self._reader.number(of_part, name, default)
        else:
            value = self._reader.number(section, f"{self._name[0].lower()}{part.lower()} {name}", default)
        if value < 0:
            raise self._reader.error(section, f"{name} of {self._name} {part} is {value:g} m; it may not be negative")
        return value

    def _section(self, section: Element, part: str) -> Element | None:
        return _section(section, f"{self._name} {part}")


@dataclass(frozen=True)
class _Reader:
    """Takes checked values from a file's sections; every error begins with the file's name."""

    path: Path
    root: Element

    def road(self, with_sides: bool) -> Road:
        """The whole road from its start line on, its walls at its edges or beyond what lies beside it."""
        stretches = list(self._stretches(with_sides))
        rows = np.concatenate(list(_drawn(stretches)))
        gap = rows[-1, :2] - rows[0, :2]
        width = min(min(each.left) + min(each.right) for each in stretches)
        if np.hypot(*gap) > width / 2:
            raise TrackError(
                f"track '{self.path.name}': the road ends {np.hypot(*gap):.2f} m from where it begins, after "
                f"{np.degrees(rows[-1, 2]):.1f} degrees of turning; a circuit must come back to its start"
            )
        steps = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)
        rows[:, :2] -= np.outer(np.concatenate([[0], steps.cumsum()]) / steps.sum(), gap)
        rows, repeats = without_repeats(drop_closing_point(rows))
        if len(rows) < MIN_POINTS or np.abs(rows[:, :2]).max() > MAX_COORDINATE:
            raise TrackError(f"track '{self.path.name}': the road is too small or too large to be drawn")
        centre, (heading, left, right) = rows[:, :2], rows[:, 2:].T
        to_left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        return Road(centre, centre + to_left * left[:, None], centre - to_left * right[:, None], repeats)

    def _stretches(self, with_sides: bool) -> Iterator[_Stretch]:
        """The road's straights and arcs in driving order."""
        main = _section(self.root, "Main Track") if self.root.tag == "params" else None
        segments = None if main is None else _section(main, "Track Segments", "segments")
        if main is None or segments is None:
            raise TrackError(
                f"track '{self.path.name}': this is no track of TORCS: it has no 'Main Track' with 'Track Segments'"
            )
        half = self.number(main, "width", 15.0) / 2
        if half <= 0:
            raise self.error(main, f"width is {2 * half:g} m; it must be positive")
        step_length = self.number(main, "profil steps length", 0.0)
        sides = _Side("Left", main, self), _Side("Right", main, self)
        length, points, count, none = 0.0, 0, 0, (0.0, 0.0)
        for segment in segments.iterfind("section"):
            arcs = self._arcs(segment, step_length)
            left, right = (side.widths(segment) if with_sides else none for side in sides)
            for index, (arc_length, curvature) in enumerate(arcs):
                at = np.array([index, index + 1]) / len(arcs)
                stretch = _Stretch(
                    arc_length,
                    curvature,
                    tuple((half + left[0] + at * (left[1] - left[0])).tolist()),
                    tuple((half + right[0] + at * (right[1] - right[0])).tolist()),
                )
                length, points = length + arc_length, points + stretch.begin_at(0.0, 0.0, 0.0).steps
                count += 1
                if length > MAX_LENGTH or points > MOST_POINTS or count > MOST_STRETCHES:
                    raise self.error(
                        segment, f"the road has more than {MAX_LENGTH / 1000:.0f} km, or too many segments or steps"
                    )
                yield stretch
        if not points:
            raise TrackError(f"track '{self.path.name}': there are no segments; the road needs some")

    def _arcs(self, segment: Element, step_length: float) -> list[tuple[float, float]]:
        """Length, m, and curvature, 1/m, of the arcs of a segment: a few where its radius changes, otherwise one.

        As in TORCS, a curve with an `end radius` is cut into the steps of its height profile. The radius grows evenly
        from step to step, from the first one's to the last one's, and the steps are made longer or shorter so that the
        whole turns by `arc`; a single step has the first radius and the length of the mean one.
        """
        kind = _text(segment, "type")
        if kind == "str":
            return [(self._positive(segment, "lg"), 0.0)]
        if kind not in ("lft", "rgt"):
            raise self.error(segment, f"type is {shown(kind)}; it must be str, lft or rgt")
        sign = 1.0 if kind == "lft" else -1.0
        radius, arc = self._positive(segment, "radius"), self._positive(segment, "arc")
        end_radius = self._positive(segment, "end radius", radius)
        length = (radius + end_radius) / 2 * arc
        count = 1 if radius == end_radius else self._profile_steps(segment, length, step_length)
        if count == 1:
            return [(length, sign / radius)]
        radii = np.linspace(radius, end_radius, count)
        step = arc / float((1 / radii).sum())
        return [(step, sign / each) for each in radii.tolist()]

    def _profile_steps(self, segment: Element, length: float, step_length: float) -> int:
        if _text(segment, "profil", "spline") != "spline":
            return 1
        steps = self.number(segment, "profil steps", 1.0)
        if int(steps) == 1:
            step_length = self.number(segment, "profil steps length", step_length)
            steps = length / step_length + 1 if step_length > 0 else 1.0
        if not 1 <= steps <= MOST_STEPS:
            raise self.error(segment, f"its profile has {steps:.0f} steps; it must have 1 to {MOST_STEPS}")
        return int(steps)

    def _positive(self, segment: Element, name: str, default: float | None = None) -> float:
        value = self.number(segment, name, default)
        if value < LEAST:
            raise self.error(segment, f"{name} is {value:g}; it must be at least {LEAST:g}")
        return value

    def number(self, section: Element, name: str, default: float | None = None) -> float:
        """A number of a section in metres or radians."""
        found = _attribute(section, "attnum", name)
        if found is None:
            if default is None:
                raise self.error(section, f"{name} is missing")
            return default
        text, unit = found.get("val", ""), found.get("unit", "")
        if unit not in UNITS:
            raise self.error(
                section, f"the unit of {name} is {shown(unit)}; it must be one of {', '.join(filter(None, UNITS))}"
            )
        try:
            value = float(text.replace("_", "?")) * UNITS[unit]
        except ValueError:
            raise self.error(section, f"{name} is {shown(text)}; it must be a number") from None
        if not abs(value) <= MAX_LENGTH:  # nan fails it, too
            raise self.error(section, f"{name} is {shown(text)}; it must be a number of at most {MAX_LENGTH:.0f}")
        return value

    def error(self, section: Element, what: str) -> TrackError:
        """What is wrong in a section."""
        return TrackError(f"track '{self.path.name}': section {shown(section.get('name', ''))}: {what}")


def _section(parent: Element, *names: str) -> Element | None:
    return next((child for child in parent.iterfind("section") if child.get("name") in names), None)


def _attribute(section: Element, tag: str, name: str) -> Element | None:
    """The first attribute of that name, which TORCS takes, too, where there are several."""
    return next((child for child in section.iterfind(tag) if child.get("name") == name), None)


def _text(section: Element, name: str, default: str = "") -> str:
    found = _attribute(section, "attstr", name)
    return default if found is None else found.get("val", "")


def _drawn(stretches: list[_Stretch]) -> Iterator[np.ndarray]:
    """Rows of x and y, m, heading, rad, and the distances of the left and right wall, m: each stretch without its end.

    The last row of all is the end of the road.
    """
    pose = [0.0, 0.0, 0.0]
    for number, stretch in enumerate(stretches, start=1):
        piece = stretch.begin_at(*pose)
        walls = [begin + piece.shares * (end - begin) for begin, end in (stretch.left, stretch.right)]
        rows = np.column_stack([piece.poses(), *walls])
        yield rows if number == len(stretches) else rows[:-1]
        pose = rows[-1, :3].tolist()
