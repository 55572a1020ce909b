"""Every colour of every picture: greys, and those of Okabe and Ito (2008), which colour-blind readers can tell apart.

Nothing here waits for Matplotlib.
"""

from dataclasses import dataclass
from functools import cache
from itertools import cycle, islice
from typing import NamedTuple

PAPER, INK, FAINT = "#ffffff", "#222222", "#6b6b6b"
BLACK, BLUE, VERMILLION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
SHADES = 24
"""Of a speed: finer steps cannot be told apart."""
YELLOW, PURPLE, ORANGE, SKY = "#F0E442", "#CC79A7", "#E69F00", "#56B4E9"


@dataclass(frozen=True)
class Theme:
    """The colours of a track and a car on one background.

    Attributes:
        ground: beside the road.
        road: between the walls.
        wall: at both sides of it.
        gate: across it.
        next_gate: across it, one that stands out.
        start: the light squares of the start line.
        start_dark: its dark squares.
        centreline: where the road is too thin to be drawn, and beside what counts more.
        ink: text and outlines.
        faint: text of less weight.
        car: its body.
        other_car: that of another car of its world.
        tyre: its outline and its tyres.
        crash: a car that touches a wall.
        ray: from the car to where it sees a wall.
        actions: of the line driven; more actions begin again.
        speeds: of the line driven where the speed varies, from the least to the greatest, the brighter the faster.
    """

    ground: str
    road: str
    wall: str
    gate: str
    next_gate: str
    start: str
    start_dark: str
    centreline: str
    ink: str
    faint: str
    car: str
    other_car: str
    tyre: str
    crash: str
    ray: str
    actions: tuple[str, ...]
    speeds: tuple[str, ...]

    def action_colours(self, count: int) -> tuple[str, ...]:
        """A colour for each of so many actions."""
        return tuple(islice(cycle(self.actions), count))

    @property
    def speed_shades(self) -> tuple[str, ...]:
        """`SHADES` colours from that of the least to that of the greatest speed."""
        return tuple(self._speed_colour(shade / (SHADES - 1)) for shade in range(SHADES))

    def _speed_colour(self, share: float) -> str:
        place = share * (len(self.speeds) - 1)
        before = min(int(place), len(self.speeds) - 2)
        return blend(self.speeds[before], self.speeds[before + 1], place - before)


LIGHT = Theme(
    ground=PAPER,
    road="#dcdcdc",
    wall="#555555",
    gate=PAPER,
    next_gate=GREEN,
    start=PAPER,
    start_dark=INK,
    centreline="#c4c4c4",
    ink=INK,
    faint=FAINT,
    car=YELLOW,
    other_car=SKY,
    tyre=INK,
    crash=VERMILLION,
    ray=GREEN,
    actions=(BLACK, VERMILLION, BLUE, GREEN, YELLOW),
    speeds=("#2c105c", "#711f81", "#b73779", "#f1605d", "#ff9d5c"),
)
"""On paper and in videos: forward is black, left vermillion, right blue."""
DARK = Theme(
    ground="#1d2429",
    road="#414b53",
    wall="#e8eaec",
    gate="#77838c",
    next_gate=YELLOW,
    start="#f4f5f6",
    start_dark="#0b0e10",
    centreline="#39454d",
    ink="#f4f5f6",
    faint="#a9b3ba",
    car=YELLOW,
    other_car=PURPLE,
    tyre="#0b0e10",
    crash=VERMILLION,
    ray="#00c794",
    actions=("#f4f5f6", VERMILLION, SKY),
    speeds=("#8f5bd6", "#d8569f", "#ff7f5e", "#ffc46b", "#fff6c0"),
)
"""On screens and in viewers: forward is white, left vermillion, right sky blue."""
LAPS = (BLUE, VERMILLION, GREEN, "#b8397f", "#8a6d00", INK)
"""Of laps that are compared, on white."""
INFO, WARNING, ERROR = DARK.faint, ORANGE, "#f0593e"
"""How bad an event is, on a dark background."""


class Colour(NamedTuple):
    """Red, green and blue, each 0..255."""

    red: int
    green: int
    blue: int


@cache
def rgb(name: str) -> Colour:
    """The colour that CSS writes as `#rrggbb`."""
    return Colour(*bytes.fromhex(name.removeprefix("#")))


def blend(first: str, second: str, share: float) -> str:
    """The colour that lies this share, 0..1, of the way from the first to the second."""
    return "#" + bytes(round(a + share * (b - a)) for a, b in zip(rgb(first), rgb(second), strict=True)).hex()


def nearness_colour(reading: float) -> str:
    """The colour of a ray that reads this, 0..1: from vermillion over yellow to sky blue."""
    near = blend(VERMILLION, YELLOW, min(1.0, 2 * reading))
    return near if reading < 0.5 else blend(YELLOW, SKY, min(1.0, 2 * reading - 1))
