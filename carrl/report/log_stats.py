"""What the episodes of a log add up to: how far they came, how they ended, where cars crashed.

Shapes: `E` episodes, `A` actions, `G` gates, `P` points of a centreline, `K` places. A section of a track lies between
two gates; section 0 between the start line and the first of them. A station is a distance along the centreline.
"""

import typing
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from carrl.errors import LogError
from carrl.log.messages import Ended, Episode
from carrl.log.scene import Floats, Scene, TrackShape

NO_EPISODE = "no episode has ended in this log, so there is nothing to say of returns, lengths, laps and crashes"
CONTROL_EDGES = np.linspace(-1, 1, 9)
"""Between which controls are counted, B + 1 of them."""
GREATEST_RETURN = 1e300
"""With greater ones, sums and differences would not be numbers."""
CHUNK = 2**17
"""So many distances between places and points are held at a time; more would not fit into a processor's cache."""


@dataclass(frozen=True, eq=False)
class LogStats:
    """The ended episodes of a log, in the order in which they ended.

    Attributes:
        scene: sensors, car and tracks.
        action_counts: how often each action was chosen in the whole log, [A].
        exploratory_share: of these choices, how many were random, in [0, 1].
        returns: undiscounted sum of each episode's rewards, [E].
        lengths: its steps, [E].
        laps: complete laps of it, [E].
        ended: why it ended, as `Episode.ended` has it, [E].
        tracks: index of its track among the scene's, [E].
        ends: where it ended, [E, 2], m.
        control_counts: where actions are numbers, how many of each control lay between two of `CONTROL_EDGES`, [C, B].
    """

    scene: Scene
    action_counts: NDArray[np.int64]
    exploratory_share: float
    returns: Floats
    lengths: NDArray[np.int64]
    laps: NDArray[np.int64]
    ended: NDArray[np.str_]
    tracks: NDArray[np.int64]
    ends: Floats
    control_counts: NDArray[np.int64] | None = None

    @staticmethod
    def of(
        episodes: Sequence[Episode],
        scene: Scene,
        action_counts: NDArray[np.int64],
        exploratory_share: float,
        control_counts: NDArray[np.int64] | None = None,
    ) -> "LogStats":
        """Gathers the messages of a log's ended episodes, of which there may be none.

        Raises:
            LogError: the log has no such track, or a figure that is no number.
        """
        stats = LogStats(
            scene=scene,
            action_counts=action_counts,
            exploratory_share=exploratory_share,
            returns=np.array([episode.episode_return for episode in episodes], dtype=np.float64),
            lengths=np.array([episode.length for episode in episodes], dtype=np.int64),
            laps=np.array([episode.laps for episode in episodes], dtype=np.int64),
            ended=np.array([episode.ended for episode in episodes], dtype=np.str_),
            tracks=np.array([episode.track for episode in episodes], dtype=np.int64),
            ends=np.array([episode.end_pose[:2] for episode in episodes], dtype=np.float64).reshape(-1, 2),
            control_counts=control_counts,
        )
        if not np.isin(stats.tracks, np.arange(len(scene.tracks))).all():
            raise LogError("the log has episodes on a track that is not attached; give the log of a run of carrl train")
        if not ((np.abs(stats.returns) <= GREATEST_RETURN).all() and np.isfinite(stats.ends).all()):
            raise LogError("the log has an episode whose return or end is no number; carrl log ls FILE shows which")
        return stats

    def __len__(self) -> int:
        """Ended episodes, E."""
        return len(self.returns)

    @property
    def collided(self) -> NDArray[np.bool_]:
        """Whether each episode ended at a wall, [E]."""
        return self.ended == "collision"

    @property
    def ends_counted(self) -> dict[str, int]:
        """How many episodes ended for each reason; other ends than walls and the time limit only if there are any."""
        counts = {name: int((self.ended == name).sum()) for name in typing.get_args(Ended)}
        return {name: count for name, count in counts.items() if count or name != "other end"}

    @cached_property
    def main_track(self) -> int:
        """Index of the track with the most ended episodes."""
        return int(np.bincount(self.tracks, minlength=1).argmax())

    @property
    def track(self) -> TrackShape:
        """The one with the most ended episodes."""
        return self.scene.tracks[self.main_track]

    @property
    def track_note(self) -> str:
        """The main track's name, and if there are others, how much of the log is about it."""
        driven = int((self.tracks == self.main_track).sum())
        share = "" if driven == len(self) else f", the track of most episodes, {driven:,} of {len(self):,}"
        return self.track.name + share

    @cached_property
    def crashes(self) -> NDArray[np.int64]:
        """Indices of the episodes that ended at a wall of the main track, in their order."""
        return np.flatnonzero(self.collided & (self.tracks == self.main_track))

    @cached_property
    def crash_places(self) -> Floats:
        """Where these cars crashed, but for those whose place is off the map, [K, 2], m."""
        places = self.ends[self.crashes]
        return places[self.track.on_map(places)]

    @property
    def off_the_map(self) -> int:
        """How many crashed off the map."""
        return len(self.crashes) - len(self.crash_places)

    @cached_property
    def crashes_by_section(self) -> NDArray[np.int64]:
        """How many cars crashed in each section of the main track, [G]."""
        return np.bincount(sections_at(self.track, self.crash_places), minlength=len(self.track.gates))


def count_controls(controls: NDArray[np.floating]) -> NDArray[np.int64]:
    """How many of the controls [T, C] lie between two of the edges: [C, B]; those beyond in the first and the last."""
    return np.stack([np.histogram(column.clip(-1, 1), CONTROL_EDGES)[0] for column in controls.T]).astype(np.int64)


def crowding(places: Floats, side: float) -> NDArray[np.int64]:
    """How many of the places [K, 2] lie in the same square of this side, m, itself among them: [K]."""
    _, squares, counts = np.unique(_squares(places, side), return_inverse=True, return_counts=True)
    return counts[squares]


def distinct(places: Floats, side: float) -> NDArray[np.int64]:
    """Indices of one of the places [K, 2] for each square of this side, m, that has any."""
    return np.unique(_squares(places, side), return_index=True)[1]


def _squares(places: Floats, side: float) -> NDArray[np.int64]:
    """A number for the square that each place is in, [K]: a single one, as NumPy sorts pairs slowly."""
    columns, rows = np.round(places / side).astype(np.int64).T
    return columns * 2**32 + rows


def section_name(section: int, gates: int) -> str:
    """Between which gates of so many a section lies; the last one is the start line."""
    names = ["start", *map(str, range(1, gates)), "start"]
    return f"{names[section]} to {names[section + 1]}"


def sections_at(track: TrackShape, places: Floats) -> NDArray[np.int64]:
    """Indices of the sections that places [K, 2], m, are in, [K]; gates stand evenly spaced along the centreline."""
    sections = stations_near(track.centreline, places) / _length(track.centreline) * len(track.gates)
    return np.minimum(sections.astype(np.int64), len(track.gates) - 1)


def stations_near(centreline: Floats, places: Floats) -> Floats:
    """Stations, m, of the points of a closed centreline [P, 2], m, that are nearest to places [K, 2], m: [K]."""
    nearest = _nearest_points(centreline, places)
    before = (nearest - 1) % len(centreline)
    on_both = [_on_segment(centreline, segment, places) for segment in (before, nearest)]
    (first, first_distance), (second, second_distance) = on_both
    return np.where(first_distance < second_distance, first, second)


def _nearest_points(centreline: Floats, places: Floats) -> NDArray[np.int64]:
    """Index of the nearest of the points [P, 2] to each place [K, 2]: [K]."""
    rows = max(1, CHUNK // len(centreline))
    middle = centreline.mean(axis=0)
    # Single precision is twice as fast, and about the middle it errs by less than the points are apart.
    points, places = ((array - middle).astype(np.float32) for array in (centreline, places))
    squares = (points**2).sum(axis=1)
    chunks = (places[begin : begin + rows] for begin in range(0, len(places), rows))
    nearest = [(squares - 2 * chunk @ points.T).argmin(axis=1) for chunk in chunks]
    return np.concatenate([np.zeros(0, dtype=np.int64), *nearest])


def _on_segment(centreline: Floats, segments: NDArray[np.int64], places: Floats) -> tuple[Floats, Floats]:
    """Station of the point of a segment that is nearest to each place, and how far it is, m, [K] both."""
    begin, way = centreline[segments], _steps(centreline)[segments]
    lengths = np.linalg.norm(way, axis=1)
    share = np.clip(((places - begin) * way).sum(axis=1) / np.maximum(lengths**2, 1e-12), 0, 1)
    stations = np.append(0.0, np.linalg.norm(_steps(centreline), axis=1).cumsum())
    return stations[segments] + share * lengths, np.linalg.norm(begin + share[:, None] * way - places, axis=1)


def _steps(centreline: Floats) -> Floats:
    """From each point of the centreline to the next, and from the last to the first, [P, 2]."""
    return np.roll(centreline, -1, axis=0) - centreline


def _length(centreline: Floats) -> float:
    return float(np.linalg.norm(_steps(centreline), axis=1).sum())
