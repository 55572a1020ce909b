"""`carrl log`: looks into a run's MCAP log."""

import argparse
import sys

from carrl.cli.log import cat, export, info, integrity, ls, show, stats
from carrl.cli.parser import Parser

VERBS = (info, ls, show, stats, cat, integrity, export)
"""Modules in the order in which their verbs are listed; each adds its own to the command line."""


def main(argv: list[str]) -> int:
    """Runs one verb of `carrl log` and returns the exit code."""
    arguments = _parser().parse_args(argv)
    exit_code = int(arguments.run(arguments))
    sys.stdout.flush()  # where a reader that has gone away is still noticed by whoever called
    return exit_code


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl log",
        description="Looks into a run's MCAP log, such as outputs/DATE/TIME/train.mcap.",
        epilog="carrl log VERB --help tells more.",
    )
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for verb in VERBS:
        verb.add_to(verbs)
    return parser
