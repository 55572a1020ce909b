"""Reads a large log in one way, in a process that imports nothing else; prints seconds and peak memory, bytes."""

import sys
import time
from pathlib import Path

from carrl.log import Log, Selection, read_episodes, read_summary


def _summarise(path: Path) -> None:
    assert read_summary(path).transitions


def _go_through(path: Path) -> None:
    with Log(path) as log:
        assert sum(len(columns["action"]) for columns in log.batches()) == log.transitions


def _list_episodes(path: Path) -> None:
    assert read_episodes(path)


def _read_one_episode(path: Path) -> None:
    with Log(path) as log:
        middle = log.transitions // 2
        [number] = next(log.batches(Selection(begin_s=0.5 * (log.span_ns or (0, 0))[1] / 1e9)))["episode"][:1]
        assert 0 < len(log.columns(Selection(episodes=[int(number)]))["action"]) < middle


THROUGH_ALL = "go through all of it"
READINGS = {
    "say what is in it": _summarise,
    THROUGH_ALL: _go_through,
    "list its episodes": _list_episodes,
    "read one episode": _read_one_episode,
}


def _peak_bytes() -> int:
    """The greatest resident memory of this process so far."""
    status = Path("/proc/self/status").read_text()
    [line] = [line for line in status.splitlines() if line.startswith("VmHWM:")]
    return int(line.split()[1]) * 1024


def main(verb: str, path: Path) -> int:
    """Reads and prints."""
    began = time.process_time()
    READINGS[verb](path)
    print(time.process_time() - began, _peak_bytes())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
