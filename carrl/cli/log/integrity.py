"""`carrl log check`: whether a log is intact, byte by byte; `carrl log recover`: a log of all that is intact in it."""

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from carrl.cli.log.shared import Verbs, add_json, add_verb, counted, print_json
from carrl.errors import DamagedLogError, printable
from carrl.log import IntactLog, Recovery, recover, verify
from carrl.log.schema import TRANSITIONS


def add_to(verbs: Verbs) -> None:
    """Adds both verbs."""
    description = (
        "Reads a log from its first byte to its last and compares every part; exit code 1 if it is not intact."
    )
    add_json(add_verb(verbs, "check", _check, "whether a log is intact; exit code 1 if it is not", description))
    description = "Writes a new log of all that is intact in one that was cut off or damaged, and tells what is lost."
    verb = add_verb(verbs, "recover", _recover, "salvage a log that was cut off or damaged", description)
    verb.add_argument("out", metavar="OUT", help="the new log; there must be no such file yet")
    verb.add_argument(
        "--run",
        dest="wanted",
        metavar="RUN",
        help="which run, if the file holds several (default: that with the most transitions)",
    )
    add_json(verb)


def _check(arguments: argparse.Namespace) -> int:
    """Says that the log is intact, or what is wrong with it."""
    try:
        intact = verify(Path(arguments.file))
    except DamagedLogError as error:
        _say(arguments, None, {"intact": False, "error": str(error)})
        print(f"carrl: {printable(str(error))}", file=sys.stderr)
        return 1
    _say(arguments, _sentence(intact), {"intact": True, **dataclasses.asdict(intact)})
    return 0


def _say(arguments: argparse.Namespace, sentence: str | None, document: dict[str, Any]) -> None:
    if arguments.json:
        print_json({"path": arguments.file, **document})
    elif sentence:
        print(sentence)


def _sentence(intact: IntactLog) -> str:
    return (
        f"intact: {counted(intact.transitions, 'transition')}, {counted(intact.episodes, 'ended episode')}, "
        f"{counted(intact.metrics, 'message')} of metrics"
    )


def _recover(arguments: argparse.Namespace) -> int:
    """Writes the new log and says what is in it."""
    recovery = recover(Path(arguments.file), Path(arguments.out), arguments.wanted)
    if arguments.json:
        print_json({"path": arguments.out, "complete": recovery.complete, **dataclasses.asdict(recovery)})
    else:
        for sentence in (_salvaged(arguments.out, recovery), *_lost(recovery)):
            print(printable(sentence))
    return 0


def _salvaged(path: str, recovery: Recovery) -> str:
    found = (
        f"{counted(recovery.transitions, 'transition')}, {counted(recovery.episodes, 'ended episode')}, "
        f"{counted(recovery.metrics, 'message')} of metrics"
    )
    return f"{path}: salvaged {found}, with {' and '.join(recovery.attachments) or 'no attachment'}."


def _lost(recovery: Recovery) -> Iterator[str]:
    if recovery.complete:
        yield "Nothing is known to be lost: the log was finished, and every part of it is there."
    if not recovery.finished:
        yield "The log was not finished: what came after its last intact part is lost, and nobody knows how much."
    for topic in recovery.topics_lost:
        yield f"Lost: topic {topic}, which every log has{_steps(recovery) if topic == TRANSITIONS else ''}."
    if recovery.transitions_lost:
        yield f"Lost: {counted(recovery.transitions_lost, 'transition')} before or between those salvaged."
    if recovery.episodes_lost:
        yield f"Lost: {counted(recovery.episodes_lost, 'ended episode')} before or between those salvaged."
    if recovery.chunks_lost:
        yield f"Lost: {counted(recovery.chunks_lost, 'chunk')} that the log's index tells of."
    if recovery.messages_lost:
        yield f"Lost: {counted(recovery.messages_lost, 'message')} that the log's statistics count."
    if recovery.metadata_lost:
        yield "Lost: the metadata, what the log said of its run; show, replay and pictures need it."
    if recovery.attachments_lost:
        yield f"Lost: {', '.join(recovery.attachments_lost)}."
    yield from _left_out(recovery)


def _steps(recovery: Recovery) -> str:
    if not recovery.episodes:
        return ""
    return f"; the ended episodes have {counted(recovery.episode_steps, 'step')}, whose transitions are not there"


def _left_out(recovery: Recovery) -> Iterator[str]:
    if recovery.unchecked:
        yield f"Not verified: {counted(recovery.unchecked, 'message')}, for which no checksum vouches."
    if recovery.duplicates_left_out:
        yield f"Left out: {counted(recovery.duplicates_left_out, 'duplicate message')}."
    if recovery.transitions_left_out:
        yield f"Left out: {counted(recovery.transitions_left_out, 'transition')} that do not follow those salvaged."
    if recovery.runs_left_out:
        which = "run" if len(recovery.runs_left_out) == 1 else "the runs"
        runs = f"{', '.join(recovery.runs_left_out):.200}"
        yield f"Left out: all of {which} {runs}; salvage another run with --run RUN."
    if recovery.others_left_out:
        yield f"Left out, for it is not part of a log: {', '.join(recovery.others_left_out)}."
