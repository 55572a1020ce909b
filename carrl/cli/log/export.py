"""`carrl log export`: transitions as a table, or an episode as a file to look at; `carrl log replay` shows it."""

import argparse
import importlib
import os
import sys
import tempfile
from pathlib import Path

from carrl.cli.log.shared import (
    Verbs,
    add_episode,
    add_selection,
    add_verb,
    check_output,
    choose_trace,
    counted,
    selection_of,
)
from carrl.cli.text.picture_progress import pictures_drawn
from carrl.errors import CarrlError, printable
from carrl.export import tables
from carrl.log.reader import Log
from carrl.log.trace import EpisodeTrace

WRITERS = {
    ".mp4": ("carrl.render.video", "write_video"),
    ".gif": ("carrl.render.video", "write_video"),
    ".html": ("carrl.export.page", "write_replay_page"),
    ".png": ("carrl.render.trace_picture", "write_picture"),
    ".pdf": ("carrl.render.trace_picture", "write_picture"),
    ".svg": ("carrl.render.trace_picture", "write_picture"),
    ".rrd": ("carrl.export.rerun", "write_recording"),
    ".mcap": ("carrl.export.foxglove", "write_viewer_log"),
}
"""Of the files that show one episode by their endings: the module, which may take long to import, and the function."""


def add_to(verbs: Verbs) -> None:
    """Adds both verbs."""
    description = (
        "Writes OUT in the format that its name ends in. .csv, .parquet and .npz hold all transitions asked for, "
        "in the columns of the log. .mp4 and .gif are a video of one episode, .html a page that replays it in any "
        "browser, .png, .pdf and .svg a picture of the line driven, .rrd a recording for Rerun, .mcap a log for "
        "Foxglove; by default of that with the highest return."
    )
    what = "a table of transitions; a video, page, picture or recording of an episode"
    verb = add_verb(verbs, "export", _export, what, description)
    verb.add_argument("out", type=Path, metavar="OUT", help="the file to write; an older one is replaced")
    add_selection(verb)
    description = "Writes a page that replays one episode, or with --rerun a recording, says where it is, and opens it."
    verb = add_verb(verbs, "replay", _replay, "replay an episode in the browser, or in Rerun", description)
    add_episode(verb)
    verb.add_argument(
        "--output", type=Path, metavar="OUT", help="where to write it (default: episode-E.html beside the log)"
    )
    verb.add_argument("--no-open", action="store_true", help="only write it")
    verb.add_argument("--rerun", action="store_true", help="a recording for Rerun, .rrd, instead of a page")


def _export(arguments: argparse.Namespace) -> int:
    """Writes the file and says what is in it."""
    source, out = Path(arguments.file), arguments.out
    ending = out.suffix.lower()
    if ending not in {**tables.WRITERS, **WRITERS}:
        endings = ", ".join([*tables.WRITERS, *WRITERS])
        raise CarrlError(f"'{out}' has no ending that names a format; choose one of: {endings}")
    check_output(out, source)
    with Log(source) as log:
        content = _write_table(log, arguments) if ending in tables.WRITERS else _write_episode(log, arguments)
    print(printable(f"{out}: {content}, {counted(out.stat().st_size, 'byte')}"))
    return 0


def _write_table(log: Log, arguments: argparse.Namespace) -> str:
    return counted(tables.write_table(arguments.out, log, selection_of(arguments)), "transition")


def _write_episode(log: Log, arguments: argparse.Namespace) -> str:
    """Writes a file that shows one episode, and says which."""
    ending = arguments.out.suffix.lower()
    episodes = arguments.episode or [None]
    others = (arguments.env, arguments.begin, arguments.end)
    if len(episodes) > 1 or any(value is not None for value in others):
        raise CarrlError(
            f"a {ending} file shows one whole episode; choose it with a single --episode and no other flag"
        )
    trace = choose_trace(log, episodes[0])
    write_episode(arguments.out, trace, _title(log, trace))
    return f"episode {trace.episode}, {counted(len(trace), 'step')}"


def _replay(arguments: argparse.Namespace) -> int:
    """Writes the page or the recording, and shows it."""
    ending = ".rrd" if arguments.rerun else ".html"
    source, out = Path(arguments.file), arguments.output
    if out is not None and out.suffix.lower() != ending:
        raise CarrlError(f"--output is '{out}'; its name must end in {ending}")
    with Log(source) as log:
        trace = choose_trace(log, arguments.episode)
        out = out or _folder_beside(source) / f"episode-{trace.episode}{ending}"
        check_output(out, source)
        write_episode(out, trace, _title(log, trace))
    print(printable(str(out)), flush=True)
    if not arguments.no_open:
        _open(out, arguments.rerun)
    return 0


def write_episode(path: Path, trace: EpisodeTrace, title: str) -> None:
    """Writes the file that shows an episode, in the format that its name ends in, one of `WRITERS`.

    Raises:
        CarrlError: it cannot be written, or a package for it is not installed.
    """
    module, function = WRITERS[path.suffix.lower()]
    write = getattr(importlib.import_module(module), function)
    if function != "write_video":
        write(path, trace, title)
        return
    with pictures_drawn() as drawn:  # drawing takes its time
        write(path, trace, title, drawn)


def _title(log: Log, trace: EpisodeTrace) -> str:
    """The run's folder and the episode's number."""
    return f"{log.path.resolve().parent.name}, episode {trace.episode}"


def _folder_beside(source: Path) -> Path:
    """The log's folder, or a new temporary one if that is read-only."""
    return source.parent if os.access(source.parent, os.W_OK) else Path(tempfile.mkdtemp(prefix="carrl-"))


def _open(path: Path, is_recording: bool) -> None:
    if is_recording:
        from carrl.export.rerun import open_recording

        open_recording(path)
        return
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        print("carrl: no browser was found here; open the page in one", file=sys.stderr)
