"""What the processes that a test has started are, and what they listen to; from /proc, so on Linux alone."""

import os
import sys
from pathlib import Path

_LISTENS = "0A"


def descendants(pid: int) -> dict[int, str]:
    """The command of every process below this one, by its id."""
    children: dict[int, list[int]] = {}
    commands = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            commands[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ").strip()
        except OSError:  # it has ended meanwhile
            continue
        children.setdefault(parent, []).append(int(folder.name))
    found, waiting = {}, [pid]
    while waiting:
        for child in children.get(waiting.pop(), []):
            found[child] = commands[child]
            waiting.append(child)
    return found


def is_running(pid: int) -> bool:
    """Whether there is such a process that is not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def addresses_listened_to(pids: list[int]) -> set[str]:
    """The addresses, in hexadecimal as the kernel writes them, at which these processes wait for connections."""
    sockets = {link for pid in pids for link in _open_files(pid)}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == _LISTENS and f"socket:[{fields[9]}]" in sockets:
                found.add(fields[1].partition(":")[0])
    return found


def _open_files(pid: int) -> list[str]:
    try:
        return [os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir()]
    except OSError:
        return []


def carrl_command(prelude: str = "pass") -> list[str]:
    """The command `carrl`, which heeds SIGINT and SIGHUP even where this process, in the background, ignores them.

    Args:
        prelude: Python code to run first.
    """
    heed = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)"
    )
    return [sys.executable, "-c", f"{prelude}; {heed}; import sys; from carrl.cli.main import main; sys.exit(main())"]
