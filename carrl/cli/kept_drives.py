"""What `carrl evaluate` keeps of the drives: a log, and a picture and a video of the best of them."""

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from carrl.errors import CarrlError, ConfigError
from carrl.evaluation.asked import check_is_free
from carrl.files import check_may_appear
from carrl.render import picture_format

PICTURES = ("png", "video")
"""Flags that draw a drive."""
VIDEOS = (".mp4", ".gif")


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds `--log`, `--png` and `--video`."""
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE.mcap",
        help="keep what the policy drove in a new file, a log like training's, for carrl log; each drive is an episode",
    )
    parser.add_argument(
        "--png", type=Path, metavar="FILE", help="draw the drive with the highest return; .pdf and .svg, too"
    )
    parser.add_argument(
        "--video", type=Path, metavar="FILE", help="the same as a video, .mp4 or .gif (pip install 'carrl[export]')"
    )


def check_flags(arguments: argparse.Namespace) -> None:
    """Tells before long work what cannot be written.

    Raises:
        CarrlError: that is so.
    """
    if arguments.log is not None:
        check_is_free(arguments.log)
    if arguments.png is not None:
        picture_format(arguments.png, "--png")
    if arguments.video is not None:
        check_file(arguments.video, "--video")
    for out in (arguments.png, arguments.video):
        if out is not None:
            check_may_appear(out)


def check_file(path: Path, flag: str, endings: tuple[str, ...] = VIDEOS) -> None:
    """Raises CarrlError where a file's name ends in none of these, or a video cannot be made here."""
    if path.suffix.lower() not in endings:
        raise ConfigError(f"{flag} is '{path}'; its name must end in {', '.join(endings[:-1])} or {endings[-1]}")
    if path.suffix.lower() in VIDEOS:
        from importlib.util import find_spec

        if find_spec("av") is None:
            raise CarrlError("a video needs PyAV, which is not installed: pip install 'carrl[export]'")


def any_asked(arguments: argparse.Namespace) -> str | None:
    """The first of the flags that was given."""
    return next((f"--{name}" for name in ("log", *PICTURES) if getattr(arguments, name) is not None), None)


@dataclass
class Kept:
    """What is kept of drives.

    Attributes:
        log: where their log is to be written; None if it has no use.
        files: what is in each file that was written.
    """

    log: Path | None = None
    files: dict[str, str] = field(default_factory=dict)


@contextmanager
def kept_drives(arguments: argparse.Namespace, name: str) -> Iterator[Kept]:
    """Says where the log of the drives is to be written; afterwards the best of them is drawn, if that is asked for.

    Args:
        arguments: with the flags.
        name: of what drives, for titles.
    """
    if any_asked(arguments) is None:
        yield Kept()
        return
    with tempfile.TemporaryDirectory(prefix="carrl-") as folder:
        log = arguments.log or Path(folder, "drives.mcap")
        kept = Kept(log)
        yield kept
        outs = [out for out in (arguments.png, arguments.video) if out is not None]
        shown = draw_best(log, outs, name) if outs else ""
        if arguments.log is not None:
            kept.files[str(arguments.log)] = "all drives, for carrl log ls, show, replay and export"
        kept.files |= {str(out): shown for out in outs}


def draw_best(log_path: Path, outs: list[Path], name: str) -> str:
    """Draws the drive with the highest return in files of these names, and says in a few words which that is."""
    from carrl.cli.log.export import write_episode
    from carrl.cli.log.shared import choose_trace, counted
    from carrl.log.reader import Log

    with Log(log_path) as log:
        trace = choose_trace(log, None)
    shown = f"drive {trace.episode} on {trace.track.name}, {counted(len(trace), 'step')}"
    for out in outs:
        write_episode(out, trace, f"{name}, drive {trace.episode} on {trace.track.name}")
    return shown
