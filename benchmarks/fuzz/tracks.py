"""Files of tracks."""

import io
import zlib
from pathlib import Path
from random import Random

import numpy as np
import yaml

from benchmarks.fuzz.mutation import NUMBERS, mutate
from benchmarks.fuzz.parser import Parser
from benchmarks.fuzz.values import change
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.csv_file import COLUMNS
from carrl.tracks.drawing import DRAWINGS
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track


class TrackParser(Parser):
    """Loads a track, looks for its faults, and builds the simulator on it, as `check`, `train` and `evaluate` do."""

    ending: str

    @property
    def path(self) -> Path:
        """Of the track's file."""
        return self.folder / f"track{self.ending}"

    def feed(self) -> None:
        """Loads, inspects, simulates."""
        track = Track.load(self.path)
        inspect_track(track)
        if self._simulates:
            Simulator(track, Vehicle(), Sensor(), compiled=False)

    @property
    def _simulates(self) -> bool:
        """Whether the simulator is built, too, which takes ten times as long: for every eighth input or so."""
        return zlib.crc32(self.path.read_bytes()) % 8 == 0


def _table(draw: Random, columns: int) -> np.ndarray:
    """A ring, a star or points anywhere, with widths beside them."""
    count = draw.choice((1, 2, 3, 4, 8, 20, 20, 60))
    angle = 2 * np.pi * np.arange(count) * draw.choice((1, 1, 1, -1, 2, count // 2)) / count
    radius = draw.choice((0.01, 1.0, 30.0, 30.0, 100.0, 5e4))
    table = np.full((count, columns), draw.choice((1e-6, 3.0, 4.0, 4.0, 50.0, 9e4)))
    table[:, :2] = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for _ in range(draw.choice((0, 0, 1, 3))):
        row = draw.randrange(count)
        table[row, :2] = [draw.uniform(-2, 2) * radius, draw.uniform(-2, 2) * radius]
    return table


class TrackCsv(TrackParser):
    """`.csv`: a centreline and its widths."""

    ending = ".csv"

    def make(self, draw: Random) -> None:
        """A table as a person's program might write it, often damaged."""
        names = list(COLUMNS) if draw.random() < 0.9 else draw.choices([*COLUMNS, "", "z"], k=draw.randint(1, 6))
        rows = [[f"{value:.6g}" for value in row] for row in _table(draw, 4).tolist()]
        for _ in range(draw.choice((0, 0, 1, 2))):
            draw.choice(rows)[draw.randrange(4)] = draw.choice(NUMBERS)
        text = "\n".join([f"# {','.join(names)}", *map(",".join, rows), ""]).encode()
        self.path.write_bytes(text if draw.random() < 0.4 else mutate(draw, text, [text, b"x_m,y_m\n"]))


class TrackDrawing(TrackParser):
    """`.yaml`: corners, or points of a line."""

    ending = ".yaml"

    def make(self, draw: Random) -> None:
        """A built-in drawing, or points, with values or the text changed."""
        drawing = DRAWINGS[draw.choice(list(DRAWINGS))]
        if draw.random() < 0.5:
            corners = [list(corner) for corner in drawing.corners]
            values = {"corners": corners, "corner_radius": drawing.corner_radius, "width": drawing.width, "gates": 8}
        else:
            values = {"points": [[round(x, 3) for x in row] for row in _table(draw, draw.choice((2, 3))).tolist()]}
            values |= {"width": draw.choice((0.01, 4.0, 8.0)), "gate_spacing": 20.0}
            values = {key: value for key, value in values.items() if key == "points" or draw.random() < 0.7}
        for _ in range(draw.choice((0, 1, 1, 2))):
            values = change(draw, values)
        text = yaml.dump(values, default_flow_style=draw.choice((True, False, None))).encode()
        self.path.write_bytes(text if draw.random() < 0.6 else mutate(draw, text, [text, b"a: &a [*a]\n"]))


class TrackWaypoints(TrackParser):
    """`.npy`: the middle and both borders of a road."""

    ending = ".npy"

    def make(self, draw: Random) -> None:
        """An array of any type, with a header or numbers that are wrong."""
        table = _table(draw, 6)
        table[:, 2:4], table[:, 4:6] = table[:, :2] * draw.choice((0.9, 0.9, 0.9, 1.1, 0)), table[:, :2] * 1.1
        for _ in range(draw.choice((0, 0, 1, 2))):
            table[draw.randrange(len(table)), draw.randrange(6)] = draw.choice((np.nan, np.inf, 1e5, 1e300, 0.0))
        file = io.BytesIO()
        odd = (np.float16, np.int32, np.uint8, bool, complex, object)
        kind = draw.choice(odd) if draw.random() < 0.3 else draw.choice((np.float64, np.float32))
        with np.errstate(all="ignore"):
            changed = table.astype(kind) if kind is not np.int32 else np.nan_to_num(table).astype(kind)
        np.save(file, np.asfortranarray(changed) if draw.random() < 0.2 else changed, allow_pickle=True)
        content = file.getvalue()
        self.path.write_bytes(content if draw.random() < 0.6 else mutate(draw, content, [content]))
