"""A hand-written program that drives cars between walls, to measure against: `scripts/bench sim --limit-program PATH`.

It is called with the number of cars, the seconds for each figure and the number of threads, and prints lines such as
`N=4096 walls=256 threads=1 poly_soa 3.723 Mcar-steps/s (cpu time) 3.722 (wall)`.
"""

import re
import subprocess
from pathlib import Path

from benchmarks.child import ROOT, BenchError, environment, last_line

ARGUMENTS = ("4096", "1.0", "1")
_FIGURE = re.compile(r"walls=256\s+threads=1\s+poly_soa\s+([\d.]+)\s+Mcar-steps/s")


def measure_limit(program: Path) -> float:
    """Its car-steps a second with 256 walls, of processor time: what it would do on an idle machine.

    Raises:
        BenchError: it failed, or did not print this figure.
    """
    try:
        done = subprocess.run(
            [program.absolute(), *ARGUMENTS], cwd=ROOT, env=environment(), capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise BenchError(f"`{program}` cannot be run: {error.strerror}") from error
    if done.returncode != 0:
        raise BenchError(f"`{program}` failed: {last_line(done.stderr)}")
    return read_limit(done.stdout)


def read_limit(output: str) -> float:
    """The figure in what it printed, car-steps a second.

    Raises:
        BenchError: it is not there.
    """
    found = _FIGURE.search(output)
    if not found:
        raise BenchError("the program of --limit-program printed no figure for 256 walls, one thread and poly_soa")
    return float(found[1]) * 1e6
