"""Errors that a user can cause and mend; the command line prints their message alone and exits with 2."""

import reprlib
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

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


T = TypeVar("T")
MOST_SEED = 2**63 - 1


def whole_number(name: str, value: Any, least: int, most: int) -> int:
    """The value as an int, NumPy's integers too.

    Raises:
        ConfigError: it is no whole number, as True is none, or too small or too large.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and least <= value <= most:
        return int(value)
    raise ConfigError(f"{name} is {shown(value)}; it must be a whole number, at least {least} and at most {most}")


def seed_number(seed: Any, name: str = "seed") -> int:
    """The seed as an int.

    Raises:
        ConfigError: it is no whole number from 0 to `MOST_SEED`.
    """
    return whole_number(name, seed, 0, MOST_SEED)


def seed_list(seed: Any) -> list[int | None]:
    """The seeds of a list, or of one seed alone; None stands for a fresh one.

    Raises:
        ConfigError: one of them is no seed.
    """
    if isinstance(seed, np.ndarray) or (isinstance(seed, Sequence) and not isinstance(seed, str | bytes)):
        return [None if each is None else seed_number(each, f"seed[{place}]") for place, each in enumerate(seed)]
    return [None if seed is None else seed_number(seed)]


def flag(name: str, value: Any) -> bool:
    """The value as a bool.

    Raises:
        ConfigError: it is something else, such as the text "no", which Python takes for true.
    """
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise ConfigError(f"{name} is {shown(value)}; it must be True or False")


def number(name: str, value: Any, least: float, most: float, wanted: str) -> float:
    """The value as a float.

    Raises:
        ConfigError: it is no number, or too small or too large; the message says what is `wanted`.
    """
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if is_number and least <= value <= most:  # nan fails it, too
        return float(value)
    raise ConfigError(f"{name} is {shown(value)}; it must be {wanted}")


def instance(name: str, value: Any, kind: type[T]) -> T | None:
    """The value itself, an object of this class or None.

    Raises:
        ConfigError: it is something else.
    """
    if value is None or isinstance(value, kind):
        return value
    raise ConfigError(f"{name} is {shown(value)}; it must be a {kind.__name__}, or be left out")
