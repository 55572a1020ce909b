"""What SIGINT, SIGTERM and SIGHUP do to a training run."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carrl.train.trainer import Trainer

_SHOW_CURSOR = "\x1b[?25h"
INTERRUPTED = 130
"""The exit code of an interrupted run."""


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


@contextmanager
def stopping_on_signals(trainer: "Trainer") -> Iterator[None]:
    """Lets the first signal end the run with everything saved, and the second end the process at once.

    A second SIGHUP is passed over: a closing terminal sends it, and so does the shell in it.
    """

    def stop(number: int, _frame: object) -> None:
        if number == signal.SIGHUP:
            let_go_of_closed_terminal()
            if trainer.stopping:
                return
        if trainer.stopping:
            if sys.stderr.isatty():
                sys.stderr.write(f"{_SHOW_CURSOR}\n")
                sys.stderr.flush()
            os._exit(INTERRUPTED)
        trainer.interrupt()

    previous = {number: signal.signal(number, stop) for number in heeded()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
