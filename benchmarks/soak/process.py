"""What a training run in a process of its own takes of memory, files and disk, second by second.

Source: proc(5) of the Linux manual pages.
"""

import csv
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.child import CARRL, ROOT, BenchError, environment, last_line
from carrl.train.files import METRICS, SUMMARY

INTERVAL_S = 1.0
"""Between two looks at the process."""
_MIB = 2**20
_LAST_ROWS_BYTES = 4096


@dataclass(frozen=True)
class Sample:
    """One look at a run.

    Attributes:
        seconds: since its start.
        frames: env steps that it had done when its latest episode ended.
        memory_mib: what of its memory is in RAM (RSS), MiB.
        handles: files, sockets and the like that it has open.
        threads: of the process.
        folder_mib: size of the run's folder, MiB.
    """

    seconds: float
    frames: int
    memory_mib: float
    handles: int
    threads: int
    folder_mib: float


def watch(overrides: Sequence[str]) -> Iterator[Sample]:
    """Trains with these Hydra overrides, and yields looks at the process until training has ended.

    Raises:
        BenchError: this is no Linux, or the run failed.
    """
    if not Path("/proc/self/fd").is_dir():
        raise BenchError("there is no /proc here; run it on Linux")
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryFile("w+") as console:
        run = Path(name) / "run"
        command = [sys.executable, *CARRL, *overrides, f"hydra.run.dir={run}"]
        process = subprocess.Popen(command, cwd=ROOT, env=environment(), stdout=console, stderr=subprocess.STDOUT)
        began_s = time.monotonic()
        try:
            while process.poll() is None:
                with suppress(OSError):  # it ends meanwhile, or renames a file
                    if not (run / SUMMARY).exists():  # after that it only draws its pictures
                        yield _look_at(process.pid, run, time.monotonic() - began_s)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(INTERVAL_S)
        finally:
            process.kill()
            process.wait()
        if process.returncode != 0:
            console.seek(0)
            raise BenchError(f"`carrl train {' '.join(overrides)}` failed: {last_line(console.read())}")


def _look_at(pid: int, run: Path, seconds: float) -> Sample:
    proc = Path("/proc") / str(pid)
    resident_pages = int((proc / "statm").read_text().split()[1])
    return Sample(
        seconds=seconds,
        frames=frames_in(run / METRICS),
        memory_mib=resident_pages * os.sysconf("SC_PAGE_SIZE") / _MIB,
        handles=len(os.listdir(proc / "fd")),
        threads=len(os.listdir(proc / "task")),
        folder_mib=sum(path.stat().st_size for path in run.rglob("*") if path.is_file()) / _MIB,
    )


def frames_in(metrics: Path) -> int:
    """Env steps done at the end of the latest episode in `metrics.csv`; 0 without one."""
    try:
        with metrics.open("rb") as file:
            header = next(csv.reader([file.readline().decode()]), [])
            file.seek(max(file.tell(), metrics.stat().st_size - _LAST_ROWS_BYTES))  # not all of it, each second
            rows = [line for line in file.read().decode().splitlines(keepends=True) if line.endswith("\n")]
    except FileNotFoundError:
        return 0
    return int(next(csv.reader(rows[-1:]))[header.index("frame")]) if rows else 0
