"""A track: a closed road between two walls, with directed gates across it.

Shapes: `P` points of the centreline, `S` walls, `G` gates, `B` cars. Lengths are in metres, angles in radians
counter-clockwise from +x. A *station* is a distance along the centreline from the start line, in driving order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from carrl.errors import TrackError
from carrl.tracks.adjust import adjusted
from carrl.tracks.bridges import Bridge, check_road, cut_folds, find_bridges
from carrl.tracks.centreline import Centreline, Road, Routes, gap_of
from carrl.tracks.drawing_file import DRAWINGS, MIN_GATE_SPACING
from carrl.tracks.inspection import inspect_track
from carrl.tracks.library import roads_of
from carrl.tracks.random_track import CORNER_RADIUS, CORNER_SPACING, LENGTH, MOST_DRAWS, WIDTH, random_centrelines

DEFAULT_GATE_SPACING = 30.0
"""Distance between gates on a track from a file, m; the paper's track has its 8 gates about as far apart."""


@dataclass(frozen=True, eq=False)
class Track:
    """A closed circuit.

    Where a bend is tighter than the road is wide, points of the inner wall may coincide; such walls without length are
    in `left_wall` and `right_wall` only, not in `walls`.

    Attributes:
        name: a built-in track's name, or the name of the file it came from.
        centreline: [P, 2], float32, m, in driving order; the last point joins the first. Point 0 is the start.
        left_wall: the left wall at each centreline point, [P, 2], float32, m.
        right_wall: the right wall at each centreline point, [P, 2], float32, m.
        gate_count: how many gates, evenly spaced; the last one is the start line, so passing it completes a lap.
        bridges: where the road crosses itself.
        repeats: how many points of its file were left out, since they repeated the one before.
        notes: how its file was read, where there was a choice; a phrase for each.
        reference_line: the line that its file proposes to drive, in driving order, [N, 2], float32, m; or None.
    """

    name: str
    centreline: Tensor
    left_wall: Tensor
    right_wall: Tensor
    gate_count: int
    bridges: tuple[Bridge, ...] = ()
    repeats: int = 0
    notes: tuple[str, ...] = ()
    reference_line: Tensor | None = None

    def __repr__(self) -> str:
        """One line instead of all its walls."""
        return f"Track({self.name!r}, {self.length:.1f} m, {self.gate_count} gates)"

    @staticmethod
    def load(
        name_or_path: str | Path,
        gate_spacing: float | None = None,
        scale: float = 1.0,
        width: float | None = None,
        direction: str | None = None,
        start_at: Sequence[float] | None = None,
        walls: str | None = None,
        circuit: str | int | None = None,
    ) -> "Track":
        """Loads a built-in track by name, or a file by path, or a file of the library by name.

        Args:
            name_or_path: one of `builtin_names()`, or a file; its ending tells what is in it, see docs/tracks.md; or
                the name of a file in the folders that the environment variable `CARRL_TRACKS` lists.
            gate_spacing: about how far the gates stand apart, m; by default the gates that the built-in track or the
                drawing has, and else `DEFAULT_GATE_SPACING`.
            scale: how many times as large as in the file, such as 10 for the road of a 1:10 car.
            width: of the road, m, before scaling, for a file that has a line without widths.
            direction: clockwise or counterclockwise; None as in the file.
            start_at: x and y, m, after scaling: the start line is at the nearest point of the centreline; None as in
                the file.
            walls: of a track of TORCS, road or barriers; None for those of the road.
            circuit: which one to take of a file that has many.

        Raises:
            TrackError: there is no such track, or the file does not describe one.
        """
        tracks = Track.load_all(name_or_path, gate_spacing, scale, width, direction, start_at, walls)
        names = [track.name.partition("/")[2] for track in tracks]
        wanted = None if circuit is None else str(circuit)
        if wanted is not None and wanted not in names:
            others = f"it has {_some(names)}" if len(names) > 1 else "it has only one, so leave that out"
            raise TrackError(f"track '{name_or_path}': there is no circuit '{circuit}' in it; {others}")
        if wanted is None and len(names) > 1:
            raise TrackError(
                f"track '{name_or_path}': it has {len(names)} circuits, {_some(names)}; name one as track.circuit"
            )
        return tracks[0 if wanted is None else names.index(wanted)]

    @staticmethod
    def load_all(
        name_or_path: str | Path,
        gate_spacing: float | None = None,
        scale: float = 1.0,
        width: float | None = None,
        direction: str | None = None,
        start_at: Sequence[float] | None = None,
        walls: str | None = None,
    ) -> "list[Track]":
        """The circuits of a file, of which a few formats may hold many; see `load`."""
        _check_gate_spacing(str(name_or_path), gate_spacing)
        return [
            Track.from_road(each, adjusted(each, road, scale, direction, start_at), gate_spacing)
            for each, road in roads_of(name_or_path, width=width, walls=walls)
        ]

    @staticmethod
    def random(
        seed: int,
        corner_radius: float | Sequence[float] = CORNER_RADIUS,
        width: float | Sequence[float] = WIDTH,
        length: float | Sequence[float] = LENGTH,
        gate_spacing: float | None = None,
        widening: float = 0.0,
        corner_spacing: float | Sequence[float] = CORNER_SPACING,
        hairpins: float = 0.0,
    ) -> "Track":
        """A circuit with straights, hairpins and bends to both sides; the same seed and ranges draw the same one.

        Args:
            seed: any whole number from 0 on.
            corner_radius: least radius of the centreline, m: a number, or a range (low, high) from which to draw.
            width: from wall to wall, m: a number or a range.
            length: of the centreline, m: a number or a range.
            gate_spacing: about how far the gates stand apart, m; by default `DEFAULT_GATE_SPACING`.
            widening: how much wider either half of the road may be in places, as a share; 0 for a road of one width.
            corner_spacing: about how far corners stand apart, in least radii of the centreline: a number or a range.
            hairpins: share of the narrow U-turns that are one acute corner instead of two right-angled ones.

        Raises:
            TrackError: a value is no such number or range, or no circuit has these measures.
        """
        name = f"random-{seed}"
        _check_gate_spacing(name, gate_spacing)
        for centreline in random_centrelines(seed, corner_radius, width, length, widening, corner_spacing, hairpins):
            track = Track.from_centreline(name, centreline, gate_spacing or DEFAULT_GATE_SPACING)
            if not inspect_track(track, body_radius=0.0).faults:
                return track
        raise TrackError(
            f"track '{name}': no circuit of these measures was found in {MOST_DRAWS} draws; make it longer"
        )

    @staticmethod
    def from_road(name: str, road: Road, gate_spacing: float | None = None) -> "Track":
        """A track with the gates as wished, m, or else as its file has them.

        Raises:
            TrackError: the centreline crosses itself where no bridge can be made of it.
        """
        gates = road.gates if gate_spacing is None else None
        spacing = gate_spacing or road.gate_spacing or DEFAULT_GATE_SPACING
        track = Track.from_walls(name, road.centre, road.left, road.right, spacing, gates)
        reference = None if road.reference is None else _as_tensor(road.reference)
        return replace(track, repeats=road.repeats, notes=road.notes, reference_line=reference)

    @staticmethod
    def from_centreline(
        name: str, centreline: Centreline, gate_spacing: float = DEFAULT_GATE_SPACING, gate_count: int | None = None
    ) -> "Track":
        """A track with walls beside the centreline, and gates by `gate_count` or else by `gate_spacing` m.

        Raises:
            TrackError: the centreline crosses itself where no bridge can be made of it.
        """
        return Track.from_road(name, centreline.road(gate_count, gate_spacing))

    @staticmethod
    def from_walls(
        name: str,
        centreline: np.ndarray,
        left_wall: np.ndarray,
        right_wall: np.ndarray,
        gate_spacing: float = DEFAULT_GATE_SPACING,
        gate_count: int | None = None,
    ) -> "Track":
        """Builds a track from a centreline and the walls beside its points, [P, 2] each, m; cuts folds of the walls.

        Raises:
            TrackError: the centreline crosses itself where no bridge can be made of it.
        """
        try:
            check_road(centreline)
            left, right = cut_folds(left_wall, centreline), cut_folds(right_wall, centreline)
            bridges = find_bridges(name, centreline, left, right)
        except TrackError as error:
            gap = gap_of(centreline, leads_astray=True)
            if gap is None:
                raise
            raise TrackError(f"track '{name}': {gap}") from error
        return Track(
            name=name,
            centreline=_as_tensor(centreline),
            left_wall=_as_tensor(left),
            right_wall=_as_tensor(right),
            gate_count=gate_count or max(3, round(_ring_length(centreline) / gate_spacing)),
            bridges=bridges,
        )

    def mirrored(self) -> "Track":
        """Its mirror image, y to -y: what was a turn to the left is one to the right, in the same order."""
        flip = torch.tensor([1.0, -1.0])
        return replace(
            self,
            name=f"{self.name}-mirrored",
            centreline=self.centreline * flip,
            left_wall=self.right_wall * flip,
            right_wall=self.left_wall * flip,
            reference_line=None if self.reference_line is None else self.reference_line * flip,
        )

    def reversed(self) -> "Track":
        """The same road driven the other way, from the same start line through the same gates."""

        def turn_back(points: Tensor) -> Tensor:
            return points.flip(0).roll(1, 0)  # point 0 stays the first

        return replace(
            self,
            name=f"{self.name}-reversed",
            centreline=turn_back(self.centreline),
            left_wall=turn_back(self.right_wall),
            right_wall=turn_back(self.left_wall),
            bridges=tuple(bridge.reversed(self.length) for bridge in self.bridges),
            reference_line=None if self.reference_line is None else turn_back(self.reference_line),
        )

    @property
    def road(self) -> Tensor:
        """The centreline, the left and the right wall side by side, [P, 3, 2], float32, m."""
        return torch.stack([self.centreline, self.left_wall, self.right_wall], dim=1)

    @cached_property
    def walls(self) -> Tensor:
        """Every wall as a pair of end points, left walls first, [S, 2, 2], float32, m; none without length."""
        return self._wall_segments[self._has_length]

    @cached_property
    def wall_stations(self) -> Tensor:
        """Station of the middle of the centreline's segment that each of `walls` stands beside, [S], float64, m."""
        return self._route.segment_middles.repeat(2)[self._has_length]

    @cached_property
    def gates(self) -> Tensor:
        """The gates in driving order as (left end, right end), [G, 2, 2], float32, m."""
        return self._route.walls(self._only(self.gate_stations), self.gate_stations).float()

    @cached_property
    def gate_stations(self) -> Tensor:
        """Where the gates stand along the centreline, increasing, the last at `length`, [G], float64, m."""
        return self._route.gates_of(0)

    @cached_property
    def length(self) -> float:
        """Length of the centreline, m."""
        return self._route.lengths[0].item()

    def pose_at(self, stations: Tensor) -> Tensor:
        """Poses on the centreline, in the driving direction: stations [B], m, to [B, 3], float32, m, m, rad."""
        return self._route.poses(self._only(stations), stations)

    def clearance_at(self, stations: Tensor) -> Tensor:
        """How far the walls are from the centreline, left and right: stations [B], m, to [B, 2], float64, m."""
        return self._route.clearance(self._only(stations), stations)

    def next_gate(self, stations: Tensor) -> Tensor:
        """Index of the first gate ahead of each station: [B], m, to [B], int64; one within 0.1 m lies behind."""
        return self._route.next_gate(self._only(stations), stations)

    def station_near(self, position: Tensor, low: Tensor, high: Tensor) -> Tensor:
        """The nearest station to each position [B, 2], m, between two others: see `Routes.nearest_stations`."""
        return self._route.nearest_stations(self._only(low), position, low, high)

    def as_dict(self) -> dict[str, Any]:
        """The geometry as plain values in metres, ready for JSON."""
        return {
            "name": self.name,
            "length": self.length,
            "centreline": _in_few_digits(self.centreline),
            "walls": _in_few_digits(self.walls),
            "gates": _in_few_digits(self.gates),
        }

    @cached_property
    def _wall_segments(self) -> Tensor:
        """The walls of every segment of the centreline, [2P, 2, 2], float32, m."""
        sides = (self.left_wall, self.right_wall)
        return torch.cat([torch.stack([side, side.roll(-1, 0)], dim=1) for side in sides])

    @cached_property
    def _has_length(self) -> Tensor:
        """Which of `_wall_segments` do not end where they begin, [2P], bool."""
        return (self._wall_segments[:, 0] != self._wall_segments[:, 1]).any(dim=1)

    @cached_property
    def _route(self) -> Routes:
        return Routes([self.road], [self.gate_count])

    @staticmethod
    def _only(stations: Tensor) -> Tensor:
        """Which track each station is on."""
        return torch.zeros(len(stations), dtype=torch.int64)


def builtin_names() -> list[str]:
    """Names of the tracks that come with CarRL, easiest first."""
    return list(DRAWINGS)


def _some(names: Sequence[str]) -> str:
    """Names as part of a sentence, the first of many."""
    return ", ".join(names[:50]) + (" and more" if len(names) > 50 else "")


def _check_gate_spacing(name: str, gate_spacing: float | None) -> None:
    is_number = isinstance(gate_spacing, int | float) and not isinstance(gate_spacing, bool)
    if gate_spacing is not None and not (is_number and MIN_GATE_SPACING <= gate_spacing < float("inf")):
        raise TrackError(
            f"track '{name}': gate_spacing is {gate_spacing}; it must be a number of at least {MIN_GATE_SPACING} m"
        )


def _ring_length(points: np.ndarray) -> float:
    """Length of the closed line through the points [P, 2], m."""
    return float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())


def _as_tensor(points: np.ndarray) -> Tensor:
    return torch.from_numpy(points.astype(np.float32))


def _in_few_digits(values: Tensor) -> Any:
    """Numbers of float32 as nested lists, with no more digits than tell them apart; in full they are twice as long."""
    return values.cpu().numpy().astype(str).astype(np.float64).tolist()
