"""The files that show one episode, by the ending of their name."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from carrl.log.reader import Log
from carrl.log.trace import EpisodeTrace

Writer: TypeAlias = Callable[[Path, EpisodeTrace, str], None]


def episode_title(log: Log, trace: EpisodeTrace) -> str:
    """What to call an episode: the run's folder and the episode's number."""
    return f"{log.path.resolve().parent.name}, episode {trace.episode}"


def _write_page(path: Path, trace: EpisodeTrace, title: str) -> None:
    from carrl.export.page import write_replay_page

    write_replay_page(path, trace, title)


def _write_recording(path: Path, trace: EpisodeTrace, title: str) -> None:
    from carrl.export.rerun import write_recording

    write_recording(path, trace, title)


def _write_viewer_log(path: Path, trace: EpisodeTrace, title: str) -> None:
    from carrl.export.foxglove import write_viewer_log

    write_viewer_log(path, trace, title)


def _write_video(path: Path, trace: EpisodeTrace, title: str) -> None:
    """Shows its progress on a terminal, as drawing takes its time."""
    from rich.console import Console
    from rich.progress import Progress

    from carrl.render.video import write_video

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pictures", total=None)
        write_video(path, trace, title, lambda done, of: progress.update(task, completed=done, total=of))


WRITERS: dict[str, Writer] = {
    ".mp4": _write_video,
    ".gif": _write_video,
    ".html": _write_page,
    ".rrd": _write_recording,
    ".mcap": _write_viewer_log,
}
"""Each writes a file whole or not at all, and raises a CarrlError if it cannot."""
