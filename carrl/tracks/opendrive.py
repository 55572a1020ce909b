"""OpenDRIVE files of circuits: one closed road, or a ring of roads that are linked end to end.

Shapes: `P` points of a road's reference line, `K` cubic polynomials. Distances along a road count from its own start.
"""

import math
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from carrl.errors import TrackError, shown
from carrl.tracks.centreline import MAX_COORDINATE, MIN_POINTS, MOST_POINTS, Road, drop_closing_point, without_repeats
from carrl.tracks.reference_line import Piece
from carrl.tracks.xml_file import read_xml

DRIVEN = ("driving", "bidirectional", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane")
"""Types of the lanes that are road; walls stand beyond the outermost of them."""
NOTES = ("userData", "include", "dataQuality")
"""Elements that may be anywhere and say nothing of a road's shape."""
SHORTEST = 1e-6
"""Length of a geometry, m; shorter ones are left out."""
WIDEST_GAP = 0.5
"""Between the end of a piece of road and the beginning of the next one, m."""
MAX_LENGTH = 1e5
"""Of a circuit, m."""
MOST_CIRCUITS, MOST_PARTS = 512, 10_000
"""Of a file, and geometries and laneSections of one circuit."""
MAX_NUMBER = 1e8
"""Of coordinates as they are in a file, m, which may be those of a whole country's grid."""


def read(path: Path) -> list[Road]:
    """The circuits of a file, in the direction of traffic; heights and banking are left out.

    Raises:
        TrackError: the file is no OpenDRIVE, or has no circuit.
    """
    root = read_xml(path)
    if root.tag != "OpenDRIVE":
        raise TrackError(f"track '{path.name}': this is no OpenDRIVE: its outermost element is {shown(root.tag)}")
    rings = _rings(path, [_Road(path, element) for element in root.iterfind("road")])
    return [_road(path, ring, None if len(rings) == 1 else ring[0][0].id) for ring in rings]


class _Link(NamedTuple):
    """What a road goes over into: whether that is a road, its id, and whether it is met where it begins."""

    is_road: bool
    id: str
    at_start: bool


Ring = list[tuple["_Road", bool]]
"""Roads in driving order, each with whether it is driven from its start to its end."""


def _rings(path: Path, roads: list["_Road"]) -> list[Ring]:
    """The circuits of a file.

    Raises:
        TrackError: there is none, or there are too many.
    """
    of_id = {road.id: road for road in roads}
    rings: list[Ring] = []
    reason, used = "", set[str]()
    for road in roads:
        if road.is_in_junction or road.id in used:
            continue
        way, ending = _follow(road, of_id, used)
        used |= {each.id for each, _ in way}
        if ending is None:
            rings.append(way)
        reason = reason or ending or ""
        if len(rings) > MOST_CIRCUITS:
            raise TrackError(f"track '{path.name}': it has more than {MOST_CIRCUITS} circuits; leave out some")
    if not rings:
        raise TrackError(
            f"track '{path.name}': {reason or 'there is no road in it'}; a circuit is a closed road, or a ring of "
            "roads linked without a junction"
        )
    return rings


def _follow(start: "_Road", of_id: dict[str, "_Road"], used: set[str]) -> tuple[Ring, str | None]:
    """The roads from one on, and how they end; None if that is where they begin.

    Where they run into a ring, they are those that lead to it.
    """
    way, places = [(start, True)], {start.id: 0}
    while True:
        last, forwards = way[-1]
        link = last.link("successor" if forwards else "predecessor")
        if link is None and len(way) == 1 and start.gap <= WIDEST_GAP:
            return way, None  # closed, though no link says so
        if link is None or link.id not in of_id or not link.is_road:
            ending = "ends" if link is None else "runs into no road" if link.is_road else "runs into a junction"
            return way, f"road {shown(last.id)} {ending}"
        if link.id in places and way[places[link.id]][1] == link.at_start:
            if link.id == start.id:
                return way, None
            return way[: places[link.id]], f"road {shown(last.id)} runs into the middle of the way to it"
        if link.id in places or link.id in used:
            return way, f"road {shown(last.id)} runs into one of another way"
        places[link.id] = len(way)
        way.append((of_id[link.id], link.at_start))


def _road(path: Path, ring: Ring, name: str | None) -> Road:
    """The road between the edges of the lanes of a ring."""
    length, count, parts = 0.0, 0, []
    for road, forwards in ring:
        length, count = length + road.length, count + road.parts
        if length > MAX_LENGTH or count > MOST_PARTS:
            raise TrackError(
                f"track '{path.name}': the circuit has more than {MAX_LENGTH / 1000:.0f} km or {MOST_PARTS} parts"
            )
        edges = road.edges()
        parts.append(edges if forwards else edges[::-1, ::-1])
    for part, following in zip(parts, [*parts[1:], parts[0]], strict=True):
        gap = math.dist(part[-1].mean(axis=0), following[0].mean(axis=0))
        if gap > max(WIDEST_GAP, math.dist(*part[-1]) / 2, math.dist(*following[0]) / 2):
            raise TrackError(f"track '{path.name}': a road ends {gap:.2f} m from where the next one begins")
    left, right = np.concatenate([part[:-1] for part in parts]).transpose(1, 0, 2)
    if ring[0][0].runs_back:
        left, right = np.roll(right[::-1], 1, axis=0), np.roll(left[::-1], 1, axis=0)
    rows, repeats = without_repeats(drop_closing_point(np.column_stack([(left + right) / 2, left, right])))
    far = float(np.abs(rows).max())
    if far > MAX_COORDINATE:
        rows = rows - np.tile(np.round(rows[0, :2]), 3)
    if not MIN_POINTS <= len(rows) <= MOST_POINTS or np.abs(rows).max() > MAX_COORDINATE:
        raise TrackError(f"track '{path.name}': the road is too small or too large to be drawn")
    return Road(rows[:, 0:2], rows[:, 2:4], rows[:, 4:6], repeats, name=name)


class _Road:
    """A road's element, and what it says.

    Args:
        path: of the file, for messages.
        element: in it.
    """

    def __init__(self, path: Path, element: Element) -> None:
        self._path, self._element = path, element
        self.id = element.get("id", "")
        self.is_in_junction = element.get("junction", "-1") != "-1"

    def link(self, name: str) -> _Link | None:
        """What it goes over into at its `successor` or `predecessor` end."""
        found = self._element.find(f"link/{name}")
        if found is None:
            return None
        return _Link(
            found.get("elementType") == "road", found.get("elementId", ""), found.get("contactPoint") == "start"
        )

    @property
    def parts(self) -> int:
        """How many geometries and sections of lanes it has."""
        return len(self._pieces) + len(self._sections)

    @cached_property
    def length(self) -> float:
        """Of the reference line, m."""
        return sum(piece.length for piece in self._pieces)

    @property
    def gap(self) -> float:
        """From the end of the reference line to its beginning, m."""
        first, last = self._pieces[0], self._pieces[-1]
        return math.dist(last.poses()[-1, :2], (first.x, first.y))

    @cached_property
    def runs_back(self) -> bool:
        """Whether all its lanes are those of the traffic against the direction of the reference line."""
        sides = {side for side, _ in self._driven(self._sections[0])}
        return sides == {"right" if self._element.get("rule") == "LHT" else "left"}

    def edges(self) -> np.ndarray:
        """Left and right edge of its lanes beside points of the reference line, [P, 2, 2], m."""
        poses: list[np.ndarray] = []
        stations, begin = [], 0.0
        for index, piece in enumerate(self._pieces):
            rows = piece.poses()
            if index and math.dist(rows[0, :2], poses[-1][-1, :2]) > WIDEST_GAP:
                raise self._error(f"its geometry jumps at {begin:.1f} m")
            poses.append(rows)
            stations.append(begin + piece.shares * piece.length)
            begin += piece.length
        kept = [slice(None, -1)] * (len(poses) - 1) + [slice(None)]
        pose = np.concatenate([rows[keep] for rows, keep in zip(poses, kept, strict=True)])
        station = np.concatenate([along[keep] for along, keep in zip(stations, kept, strict=True)])
        offsets = self._offsets(station)
        to_left = np.stack([-np.sin(pose[:, 2]), np.cos(pose[:, 2])], axis=1)
        return np.asarray(pose[:, None, :2] + offsets[:, :, None] * to_left[:, None, :])

    @cached_property
    def _pieces(self) -> list[Piece]:
        pieces: list[Piece] = []
        points, length = 0, 0.0
        for element in self._in_order("planView/geometry"):
            piece = self._piece(element)
            if piece.length < SHORTEST:
                continue
            points, length = points + piece.steps, length + piece.length
            if points > MOST_POINTS or length > MAX_LENGTH or len(pieces) == MOST_PARTS:
                raise self._error(f"it has more than {MOST_POINTS} points, {MOST_PARTS} parts or {MAX_LENGTH:.0f} m")
            pieces.append(piece)
        if not pieces:
            raise self._error("it has no geometry")
        return pieces

    def _piece(self, element: Element) -> Piece:
        x, y, heading, length = (self._number(element, name) for name in ("x", "y", "hdg", "length"))
        if not 0 <= length <= MAX_LENGTH:
            raise self._error(f"a length is {length:g} m; it must be at least 0 and at most {MAX_LENGTH:g}")
        shape = next((child for child in element if child.tag not in NOTES), Element("nothing"))
        if shape.tag == "line":
            return Piece(x, y, heading, length)
        if shape.tag == "arc":
            curvature = self._number(shape, "curvature")
            return Piece(x, y, heading, length, (curvature, curvature))
        if shape.tag == "spiral":
            return Piece(x, y, heading, length, (self._number(shape, "curvStart"), self._number(shape, "curvEnd")))
        if shape.tag == "paramPoly3":
            end = 1.0 if shape.get("pRange", "normalized") == "normalized" else length
            u, v = ([self._number(shape, f"{letter}{axis}") for letter in "abcd"] for axis in "UV")
            return Piece(x, y, heading, length, polynomials=np.array([u, v]), parameter_end=end)
        raise self._error(f"its geometry is {shown(shape.tag)}; CarRL reads line, arc, spiral and paramPoly3")

    @cached_property
    def _sections(self) -> list[Element]:
        sections = self._in_order("lanes/laneSection")
        if not sections:
            raise self._error("it has no laneSection")
        if any(section.get("singleSide") == "true" for section in sections):
            raise self._error("a laneSection has lanes of a singleSide; write those of both sides in each")
        return sections

    def _in_order(self, path: str) -> list[Element]:
        """Elements that are in force from their `s` on, as they follow each other along the road."""
        return sorted(self._element.iterfind(path), key=lambda element: self._number(element, "s"))

    def _offsets(self, station: np.ndarray) -> np.ndarray:
        """How far to the left of the reference line its edges are at distances along it [P], m: [P, 2], left first."""
        shift = self._cubics(self._element.iterfind("lanes/laneOffset"), "s", station)
        begins = np.array([self._number(section, "s") for section in self._sections])
        which = np.maximum(np.searchsorted(begins, station, side="right") - 1, 0)
        offsets = np.empty((len(station), 2))
        for index, section in enumerate(self._sections):
            here = which == index
            if here.any():
                offsets[here] = self._section_offsets(section, station[here] - begins[index]) + shift[here, None]
        return offsets

    def _section_offsets(self, section: Element, along: np.ndarray) -> np.ndarray:
        """Outer borders of the outermost driven lanes of a section at distances along it [P], m: [P, 2], left first."""
        borders: dict[tuple[str, Element], np.ndarray] = {}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            lanes = section.findall(f"{side}/lane")
            inner = np.zeros(len(along))
            for lane in sorted(lanes, key=lambda lane: abs(self._number(lane, "id"))):
                if lane.find("border") is not None and lane.find("width") is None:
                    raise self._error("a lane has a border and no width; CarRL reads widths")
                outer = inner + sign * np.maximum(self._cubics(lane.iterfind("width"), "sOffset", along), 0.0)
                if lane.get("type") in DRIVEN:
                    borders[side, lane] = np.stack([np.maximum(inner, outer), np.minimum(inner, outer)], axis=1)
                inner = outer
        if not borders:
            raise self._error(f"a laneSection has no lane to drive on, of a type such as {DRIVEN[0]}")
        all_borders = np.stack(list(borders.values()))
        edges = np.stack([all_borders[:, :, 0].max(axis=0), all_borders[:, :, 1].min(axis=0)], axis=1)
        if (edges[:, 0] - edges[:, 1]).min() <= 0:
            raise self._error("its lanes have no width somewhere")
        return edges

    @staticmethod
    def _driven(section: Element) -> Iterator[tuple[str, Element]]:
        for side in ("left", "right"):
            for lane in section.iterfind(f"{side}/lane"):
                if lane.get("type") in DRIVEN:
                    yield side, lane

    def _cubics(self, elements: Iterator[Element], begin: str, at: np.ndarray) -> np.ndarray:
        """Values of cubic polynomials, each in force from its `begin` on, at distances [P]; 0 where there is none."""
        rows = sorted([self._number(each, name) for name in (begin, "a", "b", "c", "d")] for each in elements)
        if not rows:
            return np.zeros(len(at))
        table = np.array(rows)
        which = np.maximum(np.searchsorted(table[:, 0], at, side="right") - 1, 0)
        begins, a, b, c, d = table[which].T
        along = at - begins
        values = np.where(along < -SHORTEST, 0.0, a + along * (b + along * (c + along * d)))
        if not (np.abs(values) <= MAX_COORDINATE).all():
            raise self._error(f"a width or offset is more than {MAX_COORDINATE:.0f} m")
        return values

    def _number(self, element: Element, name: str) -> float:
        text = element.get(name, "")
        try:
            value = float(text.replace("_", "?"))
        except ValueError:
            raise self._error(f"{name} of {shown(element.tag)} is {shown(text)}; it must be a number") from None
        if not abs(value) <= MAX_NUMBER:
            raise self._error(f"{name} of {shown(element.tag)} is {shown(text)}; it must be at most {MAX_NUMBER:.0f}")
        return value

    def _error(self, what: str) -> TrackError:
        return TrackError(f"track '{self._path.name}': road {shown(self.id)}: {what}")
