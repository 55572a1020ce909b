"""Flags that several verbs share, and what they mean."""

import argparse
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

from carrl.errors import CarrlError, LogError
from carrl.log.codec import Selection

Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Run: TypeAlias = Callable[[argparse.Namespace], int]

_MOST_DIGITS = 18
"""Of a whole number that fits 64 bits."""


def add_verb(verbs: Verbs, name: str, run: Run, help_text: str, description: str) -> argparse.ArgumentParser:
    """Adds a verb that reads one log.

    Args:
        verbs: those of `carrl log`.
        name: the verb.
        run: what it does; returns the exit code.
        help_text: a few words for the list of verbs.
        description: what it does, in a sentence or two.
    """
    verb = verbs.add_parser(name, help=help_text, description=description)
    verb.set_defaults(run=run)
    verb.add_argument("file", metavar="FILE", help="a log, such as train.mcap in a run's folder")
    return verb


def add_json(verb: argparse.ArgumentParser, help_text: str = "print one JSON document and nothing else") -> None:
    """Adds `--json`."""
    verb.add_argument("--json", action="store_true", help=help_text)


def add_episode(verb: argparse.ArgumentParser) -> None:
    """Adds `--episode`, for a verb that shows one."""
    verb.add_argument(
        "--episode", type=whole_number, metavar="E", help="which one (default: that with the highest return)"
    )


def add_selection(verb: argparse.ArgumentParser) -> None:
    """Adds the flags that `selection_of` reads."""
    verb.add_argument(
        "--episode", type=whole_number, action="append", metavar="E", help="only this episode; may be repeated"
    )
    verb.add_argument("--env", type=whole_number, action="append", metavar="N", help="only this car; may be repeated")
    verb.add_argument("--begin", type=seconds, metavar="S", help="only from this simulated time on, s")
    verb.add_argument("--end", type=seconds, metavar="S", help="only before this simulated time, s")


def selection_of(arguments: argparse.Namespace) -> Selection:
    """Which transitions the flags ask for.

    Raises:
        LogError: the time ends before it begins.
    """
    begin, end = arguments.begin, arguments.end
    if begin is not None and end is not None and end <= begin:
        raise LogError(f"--end is {end:g} s; it must be later than --begin, {begin:g} s")
    return Selection(arguments.episode, arguments.env, begin, end)


def check_output(out: Path, source: Path) -> None:
    """Refuses to write a file over the log that it is made of, whatever both are called.

    Raises:
        CarrlError: they are one file.
    """
    with suppress(OSError, ValueError):  # whoever opens them says what is wrong
        if out.samefile(source):
            raise CarrlError(f"'{out}' is the log itself; choose another name")


def whole_number(text: str) -> int:
    """The number that is written there, from 0 on."""
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    return int(text)


def seconds(text: str) -> float:
    """The time that is written there, s."""
    try:
        time = float(text)
    except ValueError:
        time = math.nan
    if not math.isfinite(time):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds")
    return time
