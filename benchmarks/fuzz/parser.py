"""What there is to know of a parser in order to fuzz it, and one round of it."""

import resource
import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random

from carrl.errors import CarrlError

SLOW_S = 5.0
"""Processor time above which an input is a fault, s."""
HANGING_S = 60
MOST_MIB = 2048
"""Memory of the whole process above which an input is a fault."""


class Hanging(BaseException):
    """Raised in an input that does not come to an end."""


class Parser(ABC):
    """A parser and the files that it is fed with.

    Args:
        folder: an empty one, for the files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @abstractmethod
    def make(self, draw: Random) -> None:
        """Writes the next input into the folder."""

    @abstractmethod
    def feed(self) -> None:
        """Has the input read as the program would; whatever is wrong with it may only raise CarrlError."""


@dataclass(frozen=True)
class Verdict:
    """What became of an input.

    Attributes:
        accepted: whether the parser took it.
        seconds: of processor time.
        fault: what is not as it should be; None if nothing.
    """

    accepted: bool
    seconds: float
    fault: str | None = None


def judge(parser: Parser, seed: int, number: int) -> Verdict:
    """Makes the input of this number and feeds it to the parser."""
    parser.make(Random(f"{type(parser).__name__}:{seed}:{number}"))
    peak, began, accepted, fault = peak_mib(), time.process_time(), False, None
    try:
        with _ending_at_last():
            parser.feed()
        accepted = True
    except CarrlError as error:
        if "\n" in str(error) or not str(error):
            fault = f"a message that is not one line: {error!r:.200}"
    except (Exception, Hanging) as error:  # whatever it is, it is what this program looks for
        fault = f"{type(error).__name__}: {error}"
    seconds = time.process_time() - began
    if fault is None and seconds > SLOW_S:
        fault = f"it took {seconds:.1f} s"
    if fault is None and peak_mib() > max(MOST_MIB, peak):
        fault = f"memory rose from {peak:.0f} to {peak_mib():.0f} MiB"
    return Verdict(accepted, seconds, fault)


def peak_mib() -> float:
    """Memory of this process at its most so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@contextmanager
def _ending_at_last() -> Iterator[None]:
    def stop(_number: int, _frame: object) -> None:
        raise Hanging(f"no end after {HANGING_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(HANGING_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
