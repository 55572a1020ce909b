"""One episode as a recording for the Rerun viewer (https://rerun.io), with the layout of the viewer in it."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.log.trace import EpisodeTrace

VIEWER = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""Not `python -m rerun_cli`, which in Rerun 0.41 always succeeds, whatever becomes of the viewer."""
LISTEN = ("--bind", "127.0.0.1", "--port", "auto")
"""Unless told otherwise, Rerun listens on all interfaces, and hands the recording to a viewer that is already open."""


def write_recording(path: str | Path, trace: EpisodeTrace, title: str) -> None:
    """Writes an .rrd file, whole or not at all; the same episode is the same recording to the viewer.

    Args:
        path: where to write it; the folder must exist.
        trace: the episode.
        title: what the viewer calls it.

    Raises:
        CarrlError: it cannot be written there, or rerun-sdk is not installed.
    """
    try:
        from carrl.export.rerun.recording import recording_bytes
    except ImportError as error:
        raise _not_installed() from error
    write_whole(path, recording_bytes(trace, title))


def open_recording(path: str | Path) -> None:
    """Shows a recording in the Rerun viewer, which listens on this computer only, until its window is closed.

    Raises:
        CarrlError: the viewer fails, for want of a screen perhaps, or is not installed.
    """
    if importlib.util.find_spec("rerun_cli") is None:
        raise _not_installed()
    command = [sys.executable, "-c", VIEWER, os.path.abspath(path), *LISTEN]
    status = subprocess.run(command, env={"RUST_LOG": "error", **os.environ}, check=False).returncode
    if status != 0:
        raise CarrlError(f"the Rerun viewer failed, status {status}; open '{path}' on a computer with a screen")


def _not_installed() -> CarrlError:
    return CarrlError("recordings for Rerun need rerun-sdk, which is not installed; pip install 'carrl[export]'")
