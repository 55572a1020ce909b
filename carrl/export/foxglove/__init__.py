"""One episode as an MCAP log for robotics viewers: Foxglove, Lichtblick, Rerun."""

from pathlib import Path

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.log.trace import EpisodeTrace


def write_viewer_log(path: str | Path, trace: EpisodeTrace, title: str) -> None:
    """Writes an .mcap file with Foxglove's schemas, whole or not at all; the same episode gives the same bytes.

    Args:
        path: where to write it; the folder must exist.
        trace: the episode.
        title: what it is, in a line; an entry of the file's metadata.

    Raises:
        CarrlError: it cannot be written there, or foxglove-sdk is not installed.
    """
    try:
        from carrl.export.foxglove.log import log_bytes
    except ImportError as error:
        remedy = "pip install 'carrl[export]'"
        raise CarrlError(f"logs for viewers need foxglove-sdk, which is not installed; {remedy}") from error
    write_whole(path, log_bytes(trace, title))
