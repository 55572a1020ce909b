"""Pictures of tracks, laps, cars and learning; what is here does not wait for Matplotlib.

canvas.py, scene.py, car.py, trail.py, colours.py    what draws track, car, rays and way, for every picture alike
live.py, window.py    cars as they drive, as arrays or in a window
video.py, panel.py, encoding.py    an episode of a log as a video
track_map.py, lap.py    a track, and a rollout on it, on paper
curves.py    learning curves, and what all figures share
terminal.py    charts of characters
episode.py    what happened in an episode, in words
"""

import math
from pathlib import Path

from carrl.errors import CarrlError

ENDINGS = (".png", ".pdf", ".svg")
MOST_SEEN = 60.0
"""A picture that goes with the car shows its rays as far as this, m, so that the car can still be seen."""
_LEAST_STEP = 1e-300


def picture_format(path: str | Path, name: str = "the picture's file") -> str:
    """The format that a file's name asks for, such as `png`.

    Args:
        path: of the file.
        name: what it is called in the message, such as `--out`.

    Raises:
        CarrlError: it asks for none that a picture can have.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise CarrlError(f"{name} is '{path}'; its name must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
    return ending[1:]


def round_number(least: float) -> float:
    """The smallest of ..., 1, 2, 5, 10, 20, 50, ... that is not below `least`, which is positive."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(digit * power for digit in (1, 2, 5, 10) if digit * power >= least)


def round_ticks(low: float, high: float, most: int) -> list[float]:
    """Multiples of a round number from `low` to `high`, with at most so many spaces between them."""
    step = step_between(low, high, most)
    return [step * number for number in range(math.ceil(low / step), math.floor(high / step) + 1)]


def step_between(low: float, high: float, most: int) -> float:
    """A round number that is at most so many times between two others; 1 between equals, more where floats are sparse.

    Neither the difference of two floats nor a part of it need be a float above 0.
    """
    least = high / most - low / most if high > low else 1.0
    return round_number(max(least, math.ulp(low), math.ulp(high), _LEAST_STEP))


def span(low: float, high: float) -> tuple[float, float]:
    """These two, or a little to both sides of them where no chart could tell them apart."""
    margin = 0.5 if high <= low else 0.0
    least = 64 * max(math.ulp(low), math.ulp(high), _LEAST_STEP)
    return (low, high) if high - low >= least else (low - max(margin, least), high + max(margin, least))
