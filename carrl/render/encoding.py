"""Pictures into the content of a video file, H.264 or GIF, by PyAV.

Shapes: `H` and `W` pixels, `N` colours.
"""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.errors import CarrlError
from carrl.render.colours import BLACK, FAINT, INK, LAPS, LIGHT, PAPER, YELLOW, rgb

BT709, LIMITED = 1, 1
"""H.264's numbers for the colours of high definition, and for brightness from 16 to 235."""
OLD_TRAIL, RULE = "#a8a8a8", "#e0e0e0"
"""The line driven long ago, and thin lines between parts of a panel."""
_FOREGROUNDS = (*LAPS, *(FAINT, BLACK, YELLOW), *(LIGHT.wall, OLD_TRAIL, LIGHT.centreline, RULE))
_SHADES = 8
"""Steps from a background to a colour on it: at an antialiased edge the two are mixed."""


@dataclass(frozen=True)
class Encoding:
    """How pictures become a file.

    Attributes:
        ending: of the file's name.
        codec: FFmpeg's name of the compression.
        layout: FFmpeg's name of how a picture's colours are stored.
        width: of a picture, pixels.
        height: of a picture, pixels.
        rate: pictures per second.
        file_options: of the file format.
        options: of the codec.
    """

    ending: str
    codec: str
    layout: str
    width: int
    height: int
    rate: int
    file_options: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)


MP4 = Encoding(
    ending=".mp4",
    codec="libx264",
    layout="yuv420p",
    width=1280,
    height=720,
    rate=30,
    file_options={"movflags": "+faststart"},  # a browser can begin before it has the whole file
    options={"preset": "ultrafast", "crf": "22"},
)
GIF = Encoding(ending=".gif", codec="gif", layout="pal8", width=640, height=360, rate=20)
"""A GIF's pictures last whole hundredths of a second, and many viewers slow down what is faster than 50 a second."""


def encoding_for(path: Path) -> Encoding:
    """How a video of this name is made.

    Raises:
        CarrlError: the name has another ending than .mp4 and .gif, or its folder is missing.
    """
    encoding = next((encoding for encoding in (MP4, GIF) if encoding.ending == path.suffix.lower()), None)
    if encoding is None:
        raise CarrlError(f"'{path}' is no name of a video; it must end in .mp4 or .gif")
    if not path.parent.is_dir():
        raise CarrlError(f"'{path}' cannot be written: there is no folder '{path.parent}'; make it first")
    return encoding


def encoded(encoding: Encoding, pictures: Iterable[NDArray[np.uint8]]) -> bytes:
    """The content of a video file of at least one picture, each as `PixelCanvas.pixels` has it, [H, W, 4].

    Raises:
        CarrlError: PyAV is not installed.
    """
    av = _pyav()
    make_frame = _high_definition_frame(av) if encoding.codec == MP4.codec else _palette_frame(av)
    with TemporaryDirectory(prefix="carrl-") as folder:
        file = Path(folder, "video" + encoding.ending)
        with av.open(file, "w", options=dict(encoding.file_options)) as container, ThreadPoolExecutor(1) as worker:
            stream = _new_stream(container, encoding)

            def add(picture: NDArray[np.uint8]) -> None:
                container.mux(stream.encode(make_frame(picture)))

            last = worker.submit(lambda: None)
            for picture in pictures:  # each is encoded while the next one is drawn
                last.result()
                last = worker.submit(add, picture.copy())
            last.result()
            container.mux(stream.encode())
        return file.read_bytes()


def _pyav() -> Any:
    try:
        import av
    except ImportError as error:
        raise CarrlError("a video needs PyAV, which is not installed: pip install 'carrl[export]'") from error
    return av


def _high_definition_frame(av: Any) -> Callable[[NDArray[np.uint8]], Any]:
    def frame(picture: NDArray[np.uint8]) -> Any:
        # from_ndarray copies line by line, which takes longer than drawing the picture did.
        whole = av.VideoFrame.from_numpy_buffer(picture, format="rgba")
        return whole.reformat(format=MP4.layout, dst_colorspace=BT709)

    return frame


def _palette_frame(av: Any) -> Callable[[NDArray[np.uint8]], Any]:
    """Frames of the nearest colours of one palette, so that what stands still is the same in all of them."""
    colours = gif_palette()
    nearest = _nearest(colours)
    palette = np.zeros((256, 4), np.uint8)
    palette[:, 0], palette[: len(colours), 1:] = 255, colours

    def frame(picture: NDArray[np.uint8]) -> Any:
        red, green, blue = (picture[:, :, :3] >> 3).astype(np.uint16).transpose(2, 0, 1)
        return av.VideoFrame.from_ndarray((nearest[red << 10 | green << 5 | blue], palette), format=GIF.layout)

    return frame


def _nearest(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The colour [N, 3] that is nearest to each of 32 levels of red, green and blue: its index, [32,768]."""
    levels = np.round(np.linspace(0, 255, 32))
    mixtures = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
    palette = colours.astype(np.float64)
    squares = (palette**2).sum(axis=1) - 2 * mixtures @ palette.T
    return squares.argmin(axis=1).astype(np.uint8)


def _new_stream(container: Any, encoding: Encoding) -> Any:
    """A track of the file for pictures to be encoded."""
    stream = container.add_stream(encoding.codec, rate=encoding.rate, options=dict(encoding.options))
    stream.width, stream.height, stream.pix_fmt = encoding.width, encoding.height, encoding.layout
    if encoding.codec == MP4.codec:
        stream.thread_type = "FRAME"  # several pictures at a time, beside the drawing of the next
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
    return stream


def gif_palette() -> NDArray[np.uint8]:
    """Every colour that a picture has, or one very near to it, [N, 3], N at most 256: each on each background."""
    mixed = np.linspace(0, 1, _SHADES)[:, None]
    pairs = [(PAPER, colour) for colour in _FOREGROUNDS] + [(LIGHT.road, colour) for colour in _FOREGROUNDS]
    ways = [(1 - mixed) * rgb(ground) + mixed * rgb(colour) for ground, colour in [*pairs, (LIGHT.car, INK)]]
    ways.append(np.array([rgb(shade) for shade in LIGHT.speed_shades], dtype=np.float64))
    return np.unique(np.round(np.vstack(ways)).astype(np.uint8), axis=0)
