"""The video of one episode: the drive on its track, with the network's Q-values and the rewards beside it."""

from collections.abc import Callable, Iterator
from pathlib import Path

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.log.trace import EpisodeTrace
from carrl.render.action_colours import action_colours
from carrl.render.figure import FAINT, INK, VERMILLION
from carrl.render.video.canvas import Canvas, Picture, fitted
from carrl.render.video.encoding import GIF, MP4, Encoding, encoded
from carrl.render.video.motion import motion_of
from carrl.render.video.panel import Panel
from carrl.render.video.world import World

HOLD = 1.0
"""How long the last picture stays, s."""


def write_video(
    path: str | Path, trace: EpisodeTrace, title: str, progress: Callable[[int, int], None] = lambda done, of: None
) -> None:
    """Writes a video of an episode as fast as it was driven, whole or not at all.

    Args:
        path: where to write it; `.mp4` makes H.264, 1280 by 720 pixels, `.gif` a GIF of 640 by 360.
        trace: the episode.
        title: one line above the track; a long one is cut.
        progress: called with the pictures drawn and those to draw, after each.

    Raises:
        CarrlError: the name has another ending, PyAV is not installed, or the file cannot be written.
    """
    path = Path(path)
    encoding = next((encoding for encoding in (MP4, GIF) if encoding.ending == path.suffix.lower()), None)
    if encoding is None:
        raise CarrlError(f"'{path}' is no name of a video; it must end in .mp4 or .gif")
    if not path.parent.is_dir():
        raise CarrlError(f"'{path}' cannot be written: there is no folder '{path.parent}'; make it first")
    write_whole(path, encoded(encoding, _pictures(trace, title, encoding, progress)))


def _pictures(
    trace: EpisodeTrace, title: str, encoding: Encoding, progress: Callable[[int, int], None]
) -> Iterator[Picture]:
    """Every picture of the video, the last one as often as it takes to hold it."""
    motion, colours = motion_of(trace, encoding.rate), action_colours(len(trace.scene.action_names))
    canvas, world, panel = Canvas(encoding.width), World(trace, colours), Panel(trace, colours)
    for frame in range(len(motion)):
        step, share = int(motion.steps[frame]), float(motion.shares[frame])
        canvas.clear()
        world.draw(canvas, step, share, motion.poses[frame], motion.ranges[frame])
        panel.draw(canvas, step, share)
        _draw_title(canvas, trace, title, over=frame == len(motion) - 1)
        picture = canvas.picture()
        yield picture
        progress(frame + 1, len(motion))
    for _ in range(round(HOLD * encoding.rate)):
        yield picture


def _draw_title(canvas: Canvas, trace: EpisodeTrace, title: str, over: bool) -> None:
    """The title and, when it is over, how the episode ended."""
    canvas.text(24, 38, fitted(title, 22, 560), 22, INK, bold=True)
    if over:
        what = "the record ends" if trace.ended == "unfinished" else trace.ended
        colour = VERMILLION if trace.ended == "collision" else FAINT
        duration = (trace.columns["step"][-1] + 1) * trace.scene.time_step
        canvas.text(884, 38, f"{what} after {duration:,.1f} s", 20, colour, bold=True, anchor="rs")
