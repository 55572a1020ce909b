"""`carrl log replay`: one episode in the browser, or in Rerun."""

import argparse
import os
import sys
import tempfile
from pathlib import Path

from carrl.cli.log import episode_files
from carrl.cli.log.arguments import Verbs, add_episode, add_verb, check_output
from carrl.cli.log.chosen_episode import choose_trace
from carrl.cli.log.printable import printable
from carrl.errors import CarrlError
from carrl.log.reader import Log


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = "Writes a page that replays one episode, or with --rerun a recording, says where it is, and opens it."
    verb = add_verb(verbs, "replay", run, "replay an episode in the browser, or in Rerun", description)
    add_episode(verb)
    verb.add_argument(
        "--output", type=Path, metavar="OUT", help="where to write it (default: episode-E.html beside the log)"
    )
    verb.add_argument("--no-open", action="store_true", help="only write it")
    verb.add_argument("--rerun", action="store_true", help="a recording for Rerun, .rrd, instead of a page")


def run(arguments: argparse.Namespace) -> int:
    """Writes the page or the recording, and shows it."""
    ending = ".rrd" if arguments.rerun else ".html"
    source, out = Path(arguments.file), arguments.output
    if out is not None and out.suffix.lower() != ending:
        raise CarrlError(f"--output is '{out}'; its name must end in {ending}")
    with Log(source) as log:
        trace = choose_trace(log, arguments.episode)
        out = out or _folder_beside(source) / f"episode-{trace.episode}{ending}"
        check_output(out, source)
        episode_files.WRITERS[ending](out, trace, episode_files.episode_title(log, trace))
    print(printable(str(out)), flush=True)
    if not arguments.no_open:
        _open(out, arguments.rerun)
    return 0


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
