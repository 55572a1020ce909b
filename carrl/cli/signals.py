"""What SIGINT and SIGTERM do to a training run."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carrl.run.training import Training

_SHOW_CURSOR = "\x1b[?25h"
INTERRUPTED = 130
"""The exit code of an interrupted run."""


@contextmanager
def stopping_on_signals(trainer: "Training") -> Iterator[None]:
    """Lets the first SIGINT or SIGTERM end the run with everything saved, and the second end the process at once.

    Those that this process ignores it goes on to ignore.
    """

    def stop(_number: int, _frame: object) -> None:
        if trainer.stopping:
            if sys.stderr.isatty():
                sys.stderr.write(f"{_SHOW_CURSOR}\n")
                sys.stderr.flush()
            os._exit(INTERRUPTED)
        trainer.interrupt()

    heeded = [each for each in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(each) is not signal.SIG_IGN]
    previous = {number: signal.signal(number, stop) for number in heeded}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
