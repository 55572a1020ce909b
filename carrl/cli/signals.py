"""What SIGINT and SIGTERM do to a training run."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from carrl.run.training import Training

_SHOW_CURSOR = "\x1b[?25h"
INTERRUPTED = 130
"""The exit code of an interrupted run."""


@contextmanager
def stopping_on_signals(trainer: Training) -> Iterator[None]:
    """Lets the first SIGINT or SIGTERM end the run with everything saved, and the second end the process at once."""

    def stop(_number: int, _frame: object) -> None:
        if trainer.stopping:
            if sys.stderr.isatty():
                sys.stderr.write(f"{_SHOW_CURSOR}\n")
                sys.stderr.flush()
            os._exit(INTERRUPTED)
        trainer.interrupt()

    previous = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
