"""How much of the time of training a run's log takes."""

import contextlib
import io
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.options import tell
from carrl.cli.main import main as carrl
from carrl.log.writer import LogWriter
from carrl.train.callbacks import Recorder
from carrl.train.trainer import Trainer

SHARE_HEADER = ("run", "seconds of training", "of them for the log", "share")
RUNS = (
    ("experiment=fast",),
    ("trainer.frames=30000",),
    ("trainer.frames=10000", "trainer.seeds=[0..9]"),
)


def share_rows() -> list[list[str]]:
    """Trains and returns a row for each run, of processor time."""
    return [_row(overrides) for overrides in RUNS]


def _row(overrides: Sequence[str]) -> list[str]:
    spent: Counter[str] = Counter()
    tell(f"training {' '.join(overrides)}")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        for kind, name, what in (
            (Trainer, "run", "training"),
            (Recorder, "collected", "log"),
            (LogWriter, "write_episode", "log"),
            (LogWriter, "close", "log"),
        ):
            stack.enter_context(_timing(kind, name, spent, what))
        stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
        stack.enter_context(contextlib.redirect_stderr(io.StringIO()))
        carrl(["train", *overrides, f"hydra.run.dir={folder}"])
    share = spent["log"] / spent["training"]
    return [" ".join(overrides), f"{spent['training']:.1f}", f"{spent['log']:.2f}", f"{share:.1%}"]


@contextlib.contextmanager
def _timing(kind: type, name: str, spent: Counter[str], what: str) -> Iterator[None]:
    """Adds up the processor time inside a method."""
    original = getattr(kind, name)

    def timed(*arguments: Any) -> Any:
        began = time.process_time()
        try:
            return original(*arguments)
        finally:
            spent[what] += time.process_time() - began

    setattr(kind, name, timed)
    try:
        yield
    finally:
        setattr(kind, name, original)
