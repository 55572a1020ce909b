"""`carrl log ls`: the ended episodes, a row each."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from carrl.cli.log.shared import Verbs, add_json, add_verb, aligned, best_first, counted, print_json, whole_number
from carrl.errors import DamagedLogError, printable
from carrl.log.messages import Episode
from carrl.log.reader import Log
from carrl.log.trace import read_scene

ORDERS: dict[str, Callable[[Episode], float]] = {
    "episode": lambda episode: episode.episode,
    "return": best_first,
    "length": lambda episode: -episode.length,
    "time": lambda episode: episode.begin_ns,
}
"""What comes first: the lowest number, the best return, the longest, the earliest to begin."""


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = "Lists the ended episodes, a row each; one that the end of the run cut short is not among them."
    verb = add_verb(verbs, "ls", run, "the ended episodes, a row each", description)
    verb.add_argument(
        "--sort",
        choices=ORDERS,
        default="episode",
        help="by number (the default), the best return first, the longest first, or by the time of the begin",
    )
    verb.add_argument("--reverse", action="store_true", help="the other way round")
    verb.add_argument("--crashed", action="store_true", help="only those that ended with a collision")
    verb.add_argument("--lapped", action="store_true", help="only those with a complete lap")
    verb.add_argument("--env", type=whole_number, action="append", metavar="N", help="only this car; may be repeated")
    verb.add_argument("--limit", type=whole_number, metavar="N", help="only the first so many")
    add_json(verb, "print the rows as one JSON array and nothing else")


def run(arguments: argparse.Namespace) -> int:
    """Prints the episodes asked for."""
    with Log(Path(arguments.file)) as log:
        ended = list(log.episodes())
        track_names = _track_names(log)
    order = ORDERS[arguments.sort]
    chosen = [episode for episode in ended if _is_wanted(episode, arguments)]
    chosen.sort(key=lambda episode: (order(episode), episode.episode), reverse=arguments.reverse)
    shown = chosen[: arguments.limit]
    if arguments.json:
        print_json([_document(episode, track_names) for episode in shown])
    else:
        print(f"{printable(arguments.file)}: {counted(len(ended), 'episode')} ended, {len(shown):,} shown")
        _print_rows(shown, track_names)
    return 0


def _is_wanted(episode: Episode, arguments: argparse.Namespace) -> bool:
    return (
        (episode.ended == "collision" or not arguments.crashed)
        and (episode.laps > 0 or not arguments.lapped)
        and (arguments.env is None or episode.env in arguments.env)
    )


def _track_names(log: Log) -> list[str]:
    """Of the attached tracks; none if the log does not describe them."""
    try:
        return [track.name for track in read_scene(log).tracks]
    except DamagedLogError:
        return []


def _name(track: int, names: Sequence[str]) -> str | None:
    return names[track] if 0 <= track < len(names) else None


def _document(episode: Episode, track_names: Sequence[str]) -> dict[str, Any]:
    return episode._asdict() | {"track_name": _name(episode.track, track_names)}


def _print_rows(episodes: Sequence[Episode], track_names: Sequence[str]) -> None:
    headings = ["episode", "env", "begin s", "steps", "return", "gates", "laps", "ended"]
    rows = [_row(episode) for episode in episodes]
    if len(track_names) > 1 or any(episode.track > 0 for episode in episodes):
        headings.append("track")
        for row, episode in zip(rows, episodes, strict=True):
            row.append(_name(episode.track, track_names) or str(episode.track))
    for line in aligned(headings, rows, text_from=headings.index("ended")):
        print(line)


def _row(episode: Episode) -> list[str]:
    return [
        str(episode.episode),
        str(episode.env),
        f"{episode.begin_ns / 1e9:.2f}",
        str(episode.length),
        f"{episode.episode_return:g}",
        str(episode.gates),
        str(episode.laps),
        episode.ended,
    ]
