"""Files of tracks."""

import io
import json
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
from carrl.tracks.drawing_file import DRAWINGS, Drawing
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
        if isinstance(drawing, Drawing) and draw.random() < 0.5:
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


def _oval(section: str, side: str, end_radius: str) -> str:
    """A TORCS track: two straights, two half circles of which one may change its radius on the way, and sides."""
    segments = [
        '<attstr name="type" val="str"/><attnum name="lg" unit="m" val="100"/>',
        f'<attstr name="type" val="lft"/><attnum name="radius" val="40"/>{end_radius}'
        '<attnum name="arc" unit="deg" val="180"/>',
        '<attstr name="type" val="str"/><attnum name="lg" val="328.084" unit="ft"/>',
        '<attstr name="type" val="lft"/><attnum name="radius" val="40"/><attnum name="arc" val="3.14159265"/>',
    ]
    sections = "\n".join(f'<section name="s{number}">{each}{side}</section>' for number, each in enumerate(segments))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE params SYSTEM "params.dtd" [\n'
        '<!ENTITY default-surfaces SYSTEM "surfaces.xml">\n]>\n<params name="oval">\n<section name="Surfaces">'
        '&default-surfaces;</section>\n<section name="Main Track"><attnum name="width" val="10"/>'
        f'<attnum name="profil steps length" val="4"/>\n<section name="{section}">\n{sections}\n</section>'
        "</section></params>\n"
    )


class TrackTorcs(TrackParser):
    """`.xml`: straights and curves of TORCS."""

    ending = ".xml"

    def make(self, draw: Random) -> None:
        """An oval in one of the two spellings, often damaged."""
        side = draw.choice(("", '<section name="Left Side"><attnum name="end width" val="9"/></section>'))
        end_radius = draw.choice(
            ("", "", '<attnum name="end radius" val="40"/>', '<attnum name="end radius" val="60"/>')
        )
        text = _oval(draw.choice(("Track Segments", "segments")), side, end_radius).encode()
        pieces = [text, b'<!ENTITY a "b">', b"&default-surfaces;" * 100, b"<section>" * 1000]
        self.path.write_bytes(text if draw.random() < 0.2 else mutate(draw, text, pieces))


class TrackGeoJson(TrackParser):
    """`.geojson`: lines of longitudes and latitudes."""

    ending = ".geojson"

    def make(self, draw: Random) -> None:
        """A ring, a star or points anywhere, with values or the text changed."""
        table = _table(draw, 2) * draw.choice((1, 1, 3)) / 111_000 + [
            draw.choice((0, 7, 7, 179.9)),
            draw.choice((0, 50, -37, 89.9)),
        ]
        coordinates = [*table.round(7).tolist(), *table[:1].round(7).tolist()]
        values: dict[str, object] = {"type": "LineString", "coordinates": coordinates}
        if draw.random() < 0.8:
            widths = {side: [4.0] * draw.choice((len(table), 1)) for side in ("width_left", "width_right")}
            properties: dict[str, object] = {"id": "ring", **(widths if draw.random() < 0.3 else {})}
            values = {"type": "Feature", "properties": properties, "geometry": values}
        if draw.random() < 0.6:
            values = {"type": "FeatureCollection", "features": [values] * draw.choice((1, 1, 1, 0, 2))}
        for _ in range(draw.choice((0, 0, 1, 2))):
            values = change(draw, values)
        text = json.dumps(values, default=str).encode()
        self.path.write_bytes(text if draw.random() < 0.6 else mutate(draw, text, [text, b"[" * 3000, b"1e400"]))


_ROAD = """<road id="{id}" length="{length}" junction="-1"><link><predecessor elementType="road" elementId="{before}" \
contactPoint="end"/><successor elementType="road" elementId="{after}" contactPoint="start"/></link><planView>\
<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry></planView><lanes>\
<laneOffset s="0" a="0.5" b="0" c="0" d="0"/><laneSection s="0"><center><lane id="0" type="none"/></center><right>\
<lane id="-1" type="driving"><width sOffset="0" a="8" b="0.001" c="0" d="0"/></lane></right>\
</laneSection></lanes></road>
"""


class TrackOpenDrive(TrackParser):
    """`.xodr`: roads of OpenDRIVE."""

    ending = ".xodr"

    def make(self, draw: Random) -> None:
        """A ring of two straights and two half circles, often damaged."""
        half = 40 * np.pi
        arc = draw.choice(('<arc curvature="0.025"/>', '<spiral curvStart="0.025" curvEnd="0.025"/>'))
        line = "<line/>"
        if draw.random() < 0.3:
            line = '<paramPoly3 pRange="normalized" aU="0" bU="100" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>'
        places = [
            (0, 0, 0.0, 100, line),
            (100, 0, 0.0, half, arc),
            (100, 80, np.pi, 100, line),
            (0, 80, np.pi, half, arc),
        ]
        roads = [
            _ROAD.format(
                id=index,
                before=(index - 1) % 4,
                after=(index + 1) % 4,
                x=x,
                y=y,
                heading=heading,
                length=length,
                shape=shape,
            )
            for index, (x, y, heading, length, shape) in enumerate(places)
        ]
        text = f"<OpenDRIVE>{''.join(roads)}</OpenDRIVE>".encode()
        pieces = [text, roads[0].encode(), b"<junction/>", b"<poly3/>"]
        self.path.write_bytes(text if draw.random() < 0.2 else mutate(draw, text, pieces))
