"""A lap as a table: where the car is at each station, how it moves, and what its driver does.

Shapes: `S` stations. Units: m, s, rad; angles counter-clockwise and to the left positive.
"""

import dataclasses
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.errors import TrackError
from carrl.files import read_whole, write_whole

Floats = NDArray[np.float64]

COLUMNS = {
    "station_m": "station",
    "distance_m": "distance",
    "time_s": "time",
    "x_m": "x",
    "y_m": "y",
    "offset_m": "offset",
    "heading_rad": "heading",
    "speed_mps": "speed",
    "slip_rad": "slip",
    "yaw_rate_radps": "yaw_rate",
    "curvature_radpm": "curvature",
    "steering_rad": "steering",
    "steering_rate_radps": "steering_rate",
    "acceleration_mps2": "acceleration",
}
"""Of a CSV file, each with the attribute that it holds."""
MAX_FILE_BYTES = 64 * 2**20
LEAST_STATIONS = 3


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """A closed line with the speeds and controls of a car that drives it. Every column is [S], float64.

    Attributes:
        station: along the centreline of the road, m, increasing from 0.
        distance: driven since the first station, m.
        time: since the first station, s.
        x: of the centre of gravity, m.
        y: likewise.
        offset: from half-way between the walls, to the left, m.
        heading: of the car, counted on through full turns, rad.
        speed: of the centre of gravity, m/s.
        slip: the direction of the speed against the heading, rad.
        yaw_rate: rad/s.
        curvature: of the way of the centre of gravity, 1/m.
        steering: angle of the front wheels, rad.
        steering_rate: how fast that changes until the next station, rad/s.
        acceleration: asked of engine and brakes until the next station, m/s^2.
        lap_time: back at the first station, s.
        length: of the line, m.
        track_length: of the centreline, m.
        turn: by how much the car has turned after a lap, rad.
    """

    station: Floats
    distance: Floats
    time: Floats
    x: Floats
    y: Floats
    offset: Floats
    heading: Floats
    speed: Floats
    slip: Floats
    yaw_rate: Floats
    curvature: Floats
    steering: Floats
    steering_rate: Floats
    acceleration: Floats
    lap_time: float
    length: float
    track_length: float
    turn: float

    @staticmethod
    def of(places: Floats, **columns: Any) -> "ReferenceLine":
        """The line through these places [S, 2], m, whose distance and curvature are found out."""
        steps = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
        course, turn = columns["heading"] + columns["slip"], columns["turn"]
        after, before = np.append(course[1:], course[0] + turn), np.append(course[-1] - turn, course[:-1])
        # Each chord is shorter than the arc that turns as the course does.
        arcs = steps / np.sinc((after - course) / (2 * np.pi))
        distance = np.append(0, arcs.cumsum())
        curvature = (after - before) / (arcs + np.roll(arcs, 1))
        return ReferenceLine(
            x=places[:, 0],
            y=places[:, 1],
            distance=distance[:-1],
            length=float(distance[-1]),
            curvature=curvature,
            **columns,
        )

    def __len__(self) -> int:
        """How many stations."""
        return len(self.station)

    @property
    def places(self) -> Floats:
        """Of the centre of gravity, [S, 2], m."""
        return np.stack([self.x, self.y], axis=1)

    def closed(self) -> "ReferenceLine":
        """The same with the first station once more at the end, a lap later, [S + 1]."""
        later = {
            "station": self.track_length,
            "distance": self.length,
            "time": self.lap_time,
            "heading": self.turn,
        }
        columns: dict[str, Any] = {
            name: np.append(getattr(self, name), getattr(self, name)[0] + later.get(name, 0.0))
            for name in COLUMNS.values()
        }
        return dataclasses.replace(self, **columns)

    def grip_used(self, grip: float) -> Floats:
        """The acceleration of the centre of gravity from each station to the next, as a share of this one, [S]."""
        closed = self.closed()
        course = closed.heading + closed.slip
        velocity = closed.speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
        return np.linalg.norm(np.diff(velocity, axis=0), axis=1) / np.diff(closed.time) / grip

    def write(self, path: str | Path) -> None:
        """Writes a CSV file with a header; its last row is the first station a lap later.

        Raises:
            TrackError: it cannot be written there.
        """
        text = io.StringIO()
        closed = self.closed()
        np.savetxt(
            text,
            np.column_stack([getattr(closed, name) for name in COLUMNS.values()]),
            fmt="%.9g",
            delimiter=",",
            header=",".join(COLUMNS),
        )
        write_whole(path, text.getvalue().encode(), TrackError)

    @staticmethod
    def read(path: str | Path) -> "ReferenceLine":
        """The line in a CSV file that `write` wrote.

        Raises:
            TrackError: it is no such file.
        """
        name = f"line '{Path(path).name}'"
        text = read_whole(Path(path), MAX_FILE_BYTES, name, TrackError).decode(errors="replace")
        header, _, body = text.partition("\n")
        if header.removeprefix("#").replace(" ", "").strip().split(",") != list(COLUMNS):
            raise TrackError(f"{name}: its first line must be '# {','.join(COLUMNS)}'")
        try:
            table = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2)
        except ValueError as error:
            raise TrackError(f"{name}: {error}; every row must have {len(COLUMNS)} numbers") from None
        return from_table(table, name)


def from_table(table: Floats, name: str) -> ReferenceLine:
    """The line of a table whose columns are those of `COLUMNS` and whose last row is the first a lap later.

    Raises:
        TrackError: it is none; the sentence begins with `name`.
    """
    if table.ndim != 2 or table.shape[1] != len(COLUMNS) or len(table) <= LEAST_STATIONS:
        raise TrackError(f"{name}: it must have {len(COLUMNS)} columns and more than {LEAST_STATIONS} rows")
    if not np.isfinite(table).all():
        raise TrackError(f"{name}: it holds values that are no numbers")
    columns = dict(zip(COLUMNS.values(), table.T, strict=True))
    for column in ("station", "distance", "time"):
        if (np.diff(columns[column]) <= 0).any():
            raise TrackError(f"{name}: its {column} must grow from row to row")
    if (table[:, list(COLUMNS).index("speed_mps")] <= 0).any():
        raise TrackError(f"{name}: its speeds must be above 0")
    last = {column: float(values[-1] - values[0]) for column, values in columns.items()}
    return ReferenceLine(
        **{column: np.ascontiguousarray(values[:-1]) for column, values in columns.items()},
        lap_time=last["time"],
        length=last["distance"],
        track_length=last["station"],
        turn=last["heading"],
    )
