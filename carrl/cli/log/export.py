"""`carrl log export`: transitions as a table, or one episode as a video, a page or for a viewer."""

import argparse
from pathlib import Path

from carrl.cli.log import episode_files
from carrl.cli.log.arguments import Verbs, add_selection, add_verb, check_output, selection_of
from carrl.cli.log.chosen_episode import choose_trace
from carrl.cli.log.printable import printable
from carrl.cli.log.terminal import counted
from carrl.errors import CarrlError
from carrl.export import tables as log_table
from carrl.log.reader import Log


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = (
        "Writes OUT in the format that its name ends in. .csv, .parquet and .npz hold all transitions asked for, "
        "in the columns of the log. .mp4 and .gif are a video of one episode, .html a page that replays it in any "
        "browser, .rrd a recording for Rerun, .mcap a log for Foxglove; by default of that with the highest return."
    )
    verb = add_verb(
        verbs, "export", run, "a table of transitions; a video, page or recording of an episode", description
    )
    verb.add_argument("out", type=Path, metavar="OUT", help="the file to write; an older one is replaced")
    add_selection(verb)


def run(arguments: argparse.Namespace) -> int:
    """Writes the file and says what is in it."""
    source, out = Path(arguments.file), arguments.out
    ending = out.suffix.lower()
    if ending not in {**log_table.WRITERS, **episode_files.WRITERS}:
        endings = ", ".join([*log_table.WRITERS, *episode_files.WRITERS])
        raise CarrlError(f"'{out}' has no ending that names a format; choose one of: {endings}")
    check_output(out, source)
    with Log(source) as log:
        content = _write_table(log, arguments) if ending in log_table.WRITERS else _write_episode(log, arguments)
    print(printable(f"{out}: {content}, {counted(out.stat().st_size, 'byte')}"))
    return 0


def _write_table(log: Log, arguments: argparse.Namespace) -> str:
    return counted(log_table.write_table(arguments.out, log, selection_of(arguments)), "transition")


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
    episode_files.WRITERS[ending](arguments.out, trace, episode_files.episode_title(log, trace))
    return f"episode {trace.episode}, {counted(len(trace), 'step')}"
