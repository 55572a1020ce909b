"""Maps of ROS: a YAML file beside a picture of free space, as map_server and nav2 load and save them.

Shapes: `H`, `W` rows and columns of the picture; `P` points of the centreline.
"""

import io
import math
import os
import re
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from carrl.errors import TrackError, shown
from carrl.files import read_whole, write_whole
from carrl.plain_yaml import parse_yaml
from carrl.tracks.adjust import as_centreline
from carrl.tracks.centreline import MAX_COORDINATE, MIN_POINTS, Road, without_repeats
from carrl.tracks.corridor import find_corridor
from carrl.tracks.csv_file import read_csv, write_csv
from carrl.tracks.raceline import reference_beside, without_closing
from carrl.tracks.rings import CorridorError, signed_area, thinned

if TYPE_CHECKING:
    from carrl.tracks.track import Track

KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
"""What nav2's map server requires; beside them may stand `mode`, and what other tools put there."""
MAX_YAML_BYTES = 2**18
LEAST_PIXELS, MOST_PIXELS = 9, 2**24
MOST_IMAGE_BYTES = 2**25
TOLERANCE = 0.25
"""How far walls and centreline may be from the edges found in the picture after points are left out, pixels."""
_FORMATS = ("PNG", "PPM", "BMP")
_TRINARY = 3
"""Shades of a picture that has only free, occupied and unknown pixels; more of them are edges that are drawn softly."""
_FREE, _OCCUPIED = 254, 0
_THRESHOLDS = (0.65, 0.25)
"""What nav2's map saver writes."""
_KEY = rb"""(?m)^([^#\n]*[{,])?(\xef\xbb\xbf)?\s*["']?%s["']?\s*:"""
"""A key of a YAML file's mapping: alone in its line or in braces, with or without quotes."""
_BROKEN = (OSError, ValueError, SyntaxError, EOFError, TypeError, IndexError, struct.error, zlib.error, MemoryError)
"""What Pillow raises for files that are damaged."""


def is_map(path: Path) -> bool:
    """Whether a YAML file is a map rather than a drawing: it has the keys image and resolution."""
    try:
        content = read_whole(path, MAX_YAML_BYTES, f"track '{path.name}'", TrackError)
    except TrackError:
        return False
    return all(re.search(_KEY % key, content) for key in (b"image", b"resolution"))


@dataclass(frozen=True)
class MapFile:
    """What the YAML file of a map says.

    Attributes:
        image: the picture's file.
        resolution: side of a pixel, m.
        origin: x and y of the picture's lower left corner, m, m, and by how much it is turned, rad.
        negate: whether white is occupied.
        occupied_thresh: from which occupancy on a pixel is a wall.
        free_thresh: up to which it is free.
    """

    image: Path
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float

    def to_metres(self, points: np.ndarray) -> np.ndarray:
        """Points in pixels from the lower left corner, [P, 2], in the map's frame, m."""
        x, y, yaw = self.origin
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        return np.asarray(self.resolution * points @ turn + (x, y))

    def to_pixels(self, points: np.ndarray) -> np.ndarray:
        """The reverse of `to_metres`."""
        x, y, yaw = self.origin
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        return np.asarray((points - (x, y)) @ turn / self.resolution)


def read(path: Path) -> Road:
    """The road in a map: the one closed corridor of free space.

    Its middle is the centreline in the file NAME_centerline.csv beside it, if there is one, and else the line as far
    from the walls on both sides. Start and direction are those of that file, and else where the map's own origin is,
    along its x axis, which is where a robot began to map; if that is not on the road, at the nearest point,
    counter-clockwise. An island in the road joins the wall that it is nearer to.

    Raises:
        TrackError: it is no such map, or its free space is no closed corridor.
    """
    map_file = read_map_file(path)
    free, occupancy = _read_image(path, map_file)
    beside = _centreline_beside(path)
    middle = None if beside is None else read_csv(beside).points
    try:
        corridor = find_corridor(free, occupancy, None if middle is None else map_file.to_pixels(middle))
    except CorridorError as error:
        raise CorridorError(f"track '{path.name}': {error}", error.rings, error.place, error.free) from None
    lines = map_file.to_metres(np.stack([corridor.centre, corridor.left, corridor.right], axis=1))
    lines = _from_start(lines, middle)
    lines = lines[thinned(lines, TOLERANCE * map_file.resolution)]
    table, _ = without_repeats(lines.reshape(-1, 6))
    if len(table) < MIN_POINTS or not (np.abs(table) <= MAX_COORDINATE).all():
        raise TrackError(
            f"track '{path.name}': its road is a point, or lies further than {MAX_COORDINATE:.0f} m from the origin; "
            "correct resolution and origin"
        )
    origin = f"centreline, start and direction from {beside.name}" if beside else "the middle of the free space"
    islands = (f"{corridor.islands} islands in the road, each joined to the wall nearer to it",)
    reference, found = reference_beside(path)
    return Road(
        centre=table[:, :2],
        left=table[:, 2:4],
        right=table[:, 4:],
        notes=(origin, *(islands if corridor.islands else ()), *found),
        reference=without_closing(reference),
    )


def _from_start(lines: np.ndarray, middle: np.ndarray | None) -> np.ndarray:
    """The lines [P, 3, 2], counter-clockwise, from where to start and in the direction to drive."""
    centre = lines[:, 0]
    start = np.zeros(2) if middle is None else middle[0]
    first = int(np.linalg.norm(centre - start, axis=1).argmin())
    lines = np.roll(lines, -first, axis=0)
    ahead = lines[1, 0] - lines[-1, 0]
    if middle is None:
        half_width = np.linalg.norm(lines[0, 1] - lines[0, 2]) / 2
        goes_back = np.linalg.norm(lines[0, 0]) < half_width and ahead[0] < 0
    else:
        goes_back = signed_area(middle) < 0
    # Driven the other way, the walls change sides, and the first point stays the first.
    return np.roll(lines[::-1], 1, axis=0)[:, [0, 2, 1]] if goes_back else lines


def _centreline_beside(path: Path) -> Path | None:
    stems = (path.stem, path.stem.removesuffix("_map"))
    candidates = (path.with_name(f"{stem}_{word}.csv") for stem in stems for word in ("centerline", "centreline"))
    return next((each for each in candidates if os.path.isfile(each)), None)


def read_map_file(path: Path) -> MapFile:
    """Reads the YAML file of a map.

    Raises:
        TrackError: a key is missing, or its value cannot be a map's.
    """
    name = f"track '{path.name}'"
    try:
        values = parse_yaml(read_whole(path, MAX_YAML_BYTES, f"track '{path.name}'", TrackError))
    except ValueError as error:
        raise TrackError(f"{name}: {error}") from None
    missing = [key for key in KEYS if not isinstance(values, dict) or key not in values]
    if missing:
        raise TrackError(
            f"{name}: this map lacks {', '.join(missing)}; nav2's map saver writes negate: 0, "
            f"occupied_thresh: {_THRESHOLDS[0]}, free_thresh: {_THRESHOLDS[1]}"
        )
    mode = values.get("mode", "trinary")
    if str(mode).lower() not in ("trinary", "scale"):
        raise TrackError(f"{name}: mode is {shown(mode)}; CarRL reads trinary and scale")
    image, origin = values["image"], values["origin"]
    if not isinstance(image, str) or not image or "\0" in image:
        raise TrackError(f"{name}: image is {shown(image)}; it must be the name of the picture's file")
    if not isinstance(origin, list) or len(origin) not in (2, 3):
        raise TrackError(f"{name}: origin is {shown(origin)}; it must be [x, y, yaw], m, m, rad")
    x, y, yaw = (_number(name, f"origin's {key}", value) for key, value in zip("xya", [*origin, 0][:3], strict=True))
    negate = _number(name, "negate", values["negate"], 0, 1)
    occupied = _number(name, "occupied_thresh", values["occupied_thresh"], 0, 1)
    free = _number(name, "free_thresh", values["free_thresh"], 0, 1)
    if free > occupied:
        raise TrackError(f"{name}: free_thresh is {free:g}, above occupied_thresh, which is {occupied:g}")
    resolution = _number(name, "resolution", values["resolution"], 1e-3, 100)
    return MapFile(path.parent / image, resolution, (x, y, yaw), bool(negate), occupied, free)


def _number(name: str, key: str, value: Any, low: float = -MAX_COORDINATE, high: float = MAX_COORDINATE) -> float:
    if isinstance(value, str) and re.fullmatch(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+", value):
        value = float(value)  # nav2 writes 5e-17 without a point, which is a word to YAML 1.1
    if not isinstance(value, int | float) or not low <= value <= high:
        raise TrackError(f"{name}: {key} is {shown(value)}; it must be a number from {low:g} to {high:g}")
    return float(value)


def _read_image(path: Path, map_file: MapFile) -> tuple[np.ndarray, np.ndarray | None]:
    """Which pixels are free, row 0 at the bottom, [H, W], and how occupied where edges are drawn softly, 0 to 255."""
    name = f"track '{path.name}': the picture {shown(map_file.image.name)}"
    if not os.path.isfile(map_file.image):  # Path.is_file raises on a name that is too long
        raise TrackError(f"{name} is not there; put it beside the YAML file, or name its place in image")
    limits = f"pixels; it must have from {LEAST_PIXELS} to {MOST_PIXELS:,}"
    content = read_whole(map_file.image, MOST_IMAGE_BYTES, name, TrackError)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            with Image.open(io.BytesIO(content), formats=_FORMATS) as file:
                if not LEAST_PIXELS <= file.width * file.height <= MOST_PIXELS:
                    raise TrackError(f"{name} has {file.width} x {file.height} {limits}")
                image = _in_plain_colours(file)
                opaque = np.asarray(image.getchannel("A")) > 0 if "A" in image.getbands() else None
                is_deep = image.mode.startswith(("I", "F"))  # 16 bits, which Pillow keeps in 16 or 32
                flat = Image.fromarray(_in_8_bits(np.asarray(image))) if is_deep else _in_grey(image)
                count, shades = np.count_nonzero(flat.histogram()), np.asarray(flat)[::-1]
        except (Image.DecompressionBombError, Image.DecompressionBombWarning):
            raise TrackError(f"{name} has a huge number of {limits}") from None
        except (*_BROKEN, UnidentifiedImageError, Warning):
            raise TrackError(f"{name} is damaged, or neither PNG nor PGM nor BMP") from None
    occupancy = shades if map_file.negate else ~shades
    free = occupancy < map_file.free_thresh * 255
    if opaque is not None:
        free &= opaque[::-1]
    return free, occupancy if count > _TRINARY else None


def _in_plain_colours(image: Image.Image) -> Image.Image:
    """The picture without a palette, and with an alpha channel where one of its colours means transparent."""
    if "transparency" in image.info and image.mode in ("1", "L", "P", "RGB"):
        return image.convert("RGBA")
    return image.convert("RGB") if image.mode == "P" else image


def _in_grey(image: Image.Image) -> Image.Image:
    """The mean of red, green and blue, as map servers take it: yellow lines on white are walls."""
    if image.mode not in ("RGB", "RGBA"):
        return image.convert("L")
    return image.convert("RGB").convert("L", (1 / 3, 1 / 3, 1 / 3, 0))


def _in_8_bits(shades: np.ndarray) -> np.ndarray:
    return np.asarray((shades.clip(0, 2**16 - 1) // 256).astype(np.uint8))


def write(path: Path, track: "Track", resolution: float) -> list[Path]:
    """Writes a map whose free pixels are those with their middle on the road, and the centreline beside it.

    Args:
        path: of the picture, NAME.png or NAME.pgm; NAME.yaml and NAME_centerline.csv are written beside it.
        track: any without a bridge.
        resolution: side of a pixel, m.

    Returns:
        The files written.

    Raises:
        TrackError: the road crosses itself on a bridge, the picture would be too large, or a file cannot be written.
    """
    if track.bridges:
        raise TrackError(f"track '{track.name}': it crosses itself on a bridge, and a map has one level")
    sides = [side.double().numpy() for side in (track.left_wall, track.right_wall)]
    corner = np.floor(np.minimum(*(side.min(axis=0) for side in sides)) / resolution) - 3
    columns, rows = (np.ceil(np.maximum(*(side.max(axis=0) for side in sides)) / resolution) - corner + 3).astype(int)
    if columns * rows > MOST_PIXELS:
        raise TrackError(
            f"a map of {columns:,} x {rows:,} pixels has more than {MOST_PIXELS:,}; use a coarser --resolution"
        )
    on_road = np.zeros((rows, columns), dtype=bool)
    for side in sides:
        on_road ^= _inside(side / resolution - corner, rows, columns)
    picture = io.BytesIO()
    kind = "PPM" if path.suffix.lower() == ".pgm" else "PNG"
    Image.fromarray(np.where(on_road, _FREE, _OCCUPIED).astype(np.uint8)[::-1]).save(picture, kind)
    x, y = (corner * resolution).tolist()
    text = (
        f"image: {path.name}\nmode: trinary\nresolution: {resolution:.9g}\norigin: [{x:.9g}, {y:.9g}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {_THRESHOLDS[0]}\nfree_thresh: {_THRESHOLDS[1]}\n"
    )
    files = [path, path.with_suffix(".yaml"), path.with_name(f"{path.stem}_centerline.csv")]
    write_whole(path, picture.getvalue(), TrackError)
    write_whole(files[1], text.encode(), TrackError)
    write_csv(files[2], as_centreline(track))
    return files


def _inside(ring: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Which pixels have their middle inside a closed line [P, 2], pixels: [rows, columns], by the even-odd rule."""
    toggles = np.zeros((rows, columns + 1), dtype=bool)
    for (x, y), (next_x, next_y) in zip(ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True):
        if y == next_y:
            continue
        low, high = (math.ceil(each - 0.5) for each in sorted((y, next_y)))
        row = np.arange(low, high)
        at = x + (row + 0.5 - y) * (next_x - x) / (next_y - y)
        toggles[row, np.ceil(at - 0.5).astype(int).clip(0, columns)] ^= True
    return np.logical_xor.accumulate(toggles, axis=1)[:, :columns]
