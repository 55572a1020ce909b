"""Checks of what a program hands to the environments, each answered with one sentence."""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from carrl.errors import ConfigError, shown

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
