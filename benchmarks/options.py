"""What the command lines of the benchmarks have in common."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """A parser whose complaints are one sentence and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Prints what is wrong, and ends."""
        self.exit(2, f"{self.prog}: {message}\n")


def positive(kind: type[int] | type[float]) -> Callable[[str], float]:
    """Parses a number above 0 and at most a million."""

    def parse(text: str) -> float:
        value = kind(text)
        if not 0 < value <= 1e6:
            raise argparse.ArgumentTypeError(f"{text} is not above 0 and at most a million")
        return value

    parse.__name__ = "whole number" if kind is int else "number"
    return parse


def names_of(known: Sequence[str]) -> Callable[[str], list[str]]:
    """Parses contestants' names with commas between, into the order in which they are known."""

    def parse(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"no contestant '{name}'; choose from: {', '.join(known)}")
        return [name for name in known if name in names]

    return parse


def writable(text: str) -> Path:
    """Parses a file that can be written."""
    path = Path(text)
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"'{text}' cannot be written; name a file in a folder that exists")
    return path


def tell(message: str) -> None:
    """Says how far the measurement is, on stderr."""
    print(message, file=sys.stderr, flush=True)
