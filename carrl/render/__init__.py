"""Pictures of tracks, laps, cars and learning; what is here does not wait for Matplotlib.

canvas.py, scene.py, colours.py    what draws the track, the car and its rays, for every picture alike
live.py, window.py    cars as they drive, as arrays or in a window
video.py, panel.py, encoding.py    an episode of a log as a video
track_map.py, lap.py    a track, and a drive on it, on paper
curves.py, figure.py    learning curves, and what all figures share
terminal.py    charts of characters
episode.py    what happened in an episode, in words
"""

from pathlib import Path

from carrl.errors import CarrlError

ENDINGS = (".png", ".pdf", ".svg")


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
