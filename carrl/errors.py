"""Errors that a user can cause and mend; the command line prints their message alone and exits with 2."""

import reprlib
from collections.abc import Iterable

CLOSE = 0.6
"""How alike a name must be to one that there is, to be meant by it: 0 to 1."""


class CarrlError(Exception):
    """Base of every error that names its cause and its remedy in one sentence."""


class TrackError(CarrlError):
    """A track that cannot be found, read or driven."""


class ConfigError(CarrlError):
    """A parameter outside its allowed values, or a configuration that does not compose."""


class LogError(CarrlError):
    """A log file that cannot be written, or is not a readable CarRL log."""


class DamagedLogError(LogError):
    """A file that can be read, but is not an intact and finished CarRL log."""


class CheckpointError(CarrlError):
    """A run folder or checkpoint that is missing, damaged or of another version."""


def shown(value: object) -> str:
    """A value from a file as Python would write it, on one line and cut, whatever it holds.

    A few lines of YAML can stand for a list of billions of items, which `repr` would write out.
    """
    try:
        text = reprlib.repr(value)
    except ValueError:  # an integer of more digits than Python prints
        return "too long a number"
    return text if len(text) <= 40 else f"{text[:40]}..."


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """The rest of a sentence that names the nearest of the names; nothing if none is near."""
    import difflib  # here, since few runs need it and every one would wait for it

    close = difflib.get_close_matches(name, list(names), n=1, cutoff=CLOSE)
    return f"; did you mean {close[0]}?" if close else ""


def printable(text: str) -> str:
    """The text with every character that could steer a terminal, or hide in it, written as Python would escape it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
