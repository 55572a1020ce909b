"""This process: its output, which may be full, closed, or no longer read, and the signals that end it."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import StringIO
from typing import Any

from carrl.errors import CarrlError

INTERRUPTED = 130
"""The exit code of an interrupted run."""


class OutputClosedError(CarrlError):
    """Nobody reads standard output any more, as with `carrl ... | head`; not a mistake."""


class _Guarded:
    """A text stream whose failures are named, or, of standard error, passed over: a run goes on without its display."""

    def __init__(self, stream: Any, is_essential: bool) -> None:
        self._stream, self._is_essential = stream, is_essential

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Writes the text."""
        with self._naming_failures():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Hands on what is held back."""
        with self._naming_failures():
            if self._stream is not None:
                self._stream.flush()

    @contextmanager
    def _naming_failures(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            _discard(self._stream)
            if not self._is_essential:
                return
            if isinstance(error, BrokenPipeError):
                raise OutputClosedError("standard output is no longer read") from error
            raise CarrlError(f"standard output cannot be written: {error.strerror}; send it elsewhere") from error


@contextmanager
def guarded_output() -> Iterator[None]:
    """Guards both streams; a failure of standard output ends the command with one sentence.

    Raises:
        CarrlError: standard output is closed or full.
    """
    is_closed = sys.stdout is None
    _fill_closed_descriptors()
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Guarded(streams[0], True), _Guarded(streams[1] or StringIO(), False)
    try:
        if is_closed:
            raise CarrlError("standard output is closed; send it somewhere, such as >/dev/null")
        yield
        sys.stdout.flush()
    except BaseException as error:
        with suppress(*(() if isinstance(error, SystemExit) else (CarrlError,))):  # --help ends with SystemExit
            sys.stdout.flush()
        raise
    finally:
        sys.stdout, sys.stderr = streams


def _fill_closed_descriptors() -> None:
    """Takes the numbers 0 to 2 where they are free, so that no file that is opened later is mistaken for a stream."""
    while (number := os.open(os.devnull, os.O_RDWR)) < 3:
        pass
    os.close(number)


def _discard(stream: Any) -> None:
    """Sends what the stream still holds, and all that follows, nowhere; else Python complains when it ends."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def heeded() -> list[signal.Signals]:
    """The signals that end training, but for those that this process ignores, as SIGHUP under `nohup`."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    return [each for each in signals if signal.getsignal(each) is not signal.SIG_IGN]


def let_go_of_closed_terminal() -> None:
    """Lets what would be printed on a terminal that is gone vanish, so that it does not end what is to be saved."""
    for descriptor in (1, 2):
        try:
            os.write(descriptor, b"")
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, descriptor)
            if nowhere != descriptor:
                os.close(nowhere)
