"""Runs one contestant in a process of its own, on one thread."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CIRCUITS = ROOT.parent / "shared" / "tracks" / "real"
"""Where real circuits lie, if they are beside the checkout."""
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
CARRL = ("-m", "carrl.cli.main", "train")


class BenchError(Exception):
    """A measurement that could not be made; the message says which and why."""


def environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment, with every library on one thread."""
    return {**os.environ, **ONE_THREAD, **(extra or {})}


def run_child(arguments: Sequence[str], extra: Mapping[str, str] | None = None) -> tuple[str, str]:
    """Runs Python on the arguments in the project's folder and returns its stdout and stderr.

    Args:
        arguments: of Python.
        extra: variables to add to the environment.

    Raises:
        BenchError: it failed; the message ends with the last line of its stderr.
    """
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment(extra), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BenchError(f"`python {' '.join(arguments)}` failed: {last_line(done.stderr)}")
    return done.stdout, done.stderr


def last_line(text: str) -> str:
    """The last line with something on it."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it printed no reason"
