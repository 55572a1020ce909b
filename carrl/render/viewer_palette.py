"""The colours of an episode in viewers with a dark background: those of Okabe and Ito (2008), some of them lighter."""

from typing import NamedTuple


class Colour(NamedTuple):
    """Red, green and blue, each 0..255."""

    red: int
    green: int
    blue: int

    @staticmethod
    def of(name: str) -> "Colour":
        """The colour that CSS writes as `#rrggbb`."""
        return Colour(*bytes.fromhex(name.removeprefix("#")))


GROUND, CENTRELINE, WALL, GATE, START = map(Colour.of, ("#1d2429", "#39454d", "#9aa5ad", "#5d6a73", "#e8eaec"))
CAR, RAY = map(Colour.of, ("#f0e442", "#00c794"))
ACTIONS = tuple(map(Colour.of, ("#f4f5f6", "#d55e00", "#56b4e9")))
"""Forward, left, right; others begin again."""
INFO, WARNING, ERROR = map(Colour.of, ("#a9b3ba", "#e69f00", "#f0593e"))


def action_colours(count: int) -> list[Colour]:
    """A colour for each of so many actions."""
    return [ACTIONS[action % len(ACTIONS)] for action in range(count)]


def blend(first: Colour, second: Colour, share: float) -> Colour:
    """The colour that lies this share, 0..1, of the way from the first to the second."""
    return Colour(*(round(a + share * (b - a)) for a, b in zip(first, second, strict=True)))
