"""`carrl log check`: whether a log is intact, byte by byte."""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

from carrl.cli.log.arguments import Verbs, add_json, add_verb
from carrl.cli.log.printable import printable
from carrl.cli.log.terminal import counted, print_json
from carrl.errors import DamagedLogError
from carrl.log import IntactLog, verify


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = (
        "Reads a log from its first byte to its last and compares every part; exit code 1 if it is not intact."
    )
    add_json(add_verb(verbs, "check", run, "whether a log is intact; exit code 1 if it is not", description))


def run(arguments: argparse.Namespace) -> int:
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
