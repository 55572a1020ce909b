"""`carrl report`: lines up the results of runs and compares groups of them."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from carrl.cli.parser import Parser, add_trust, named_folder
from carrl.errors import ConfigError
from carrl.render import picture_format
from carrl.report.runs import check_have_runs

if TYPE_CHECKING:
    from carrl.report.findings import Findings

BIN_SIZE = 0.25
"""Of the search for the best possible lap, m."""


def main(argv: list[str]) -> int:
    """Prints a report as text or JSON, and on demand writes it with its figures into a folder."""
    arguments = _parser().parse_args(argv)
    _check(arguments)
    from carrl.cli.text.markdown_terminal import print_markdown  # From here on it takes seconds.
    from carrl.evaluation.best_lap import find_best_lap
    from carrl.report.document import as_json, write_report
    from carrl.report.findings import find
    from carrl.report.text import common_world, report_text

    findings = find(arguments.directories, arguments.baseline)
    best_lap = None
    if arguments.best_lap:
        bin_size = BIN_SIZE if arguments.bin_size is None else arguments.bin_size
        world = common_world(findings.runs, arguments.trust)
        print(f"searching for the best lap among places {bin_size} m apart (--bin-size)", file=sys.stderr)
        best_lap = find_best_lap(world, bin_size)
    if arguments.curves:
        _draw_curves(arguments.curves, findings)
    if arguments.out:
        write_report(arguments.out, findings, best_lap)
    if arguments.json:
        print(as_json(findings, best_lap))
        return 0
    print_markdown(report_text(findings, best_lap))
    if arguments.out:
        print(f"\nreport in {arguments.out}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Raises ConfigError for a flag that cannot be done as asked, before runs are read."""
    if arguments.curves:
        picture_format(arguments.curves, "--curves")
    for flag, value in (("--bin-size", arguments.bin_size is not None), ("--trust", arguments.trust)):
        if value and not arguments.best_lap:
            raise ConfigError(f"{flag} has no effect without --best-lap; add that, or leave it out")
    check_have_runs(arguments.directories)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl report",
        description="Compares runs: groups those that differ in their seed alone, tells which groups differ "
        "significantly, and names runs that are missing, broken or there twice.",
    )
    parser.add_argument("directories", nargs="+", type=Path, metavar="DIR", help="a run, or a folder of runs")
    parser.add_argument(
        "--out", type=named_folder, metavar="FOLDER", help="write report.md, CSV, JSON and figures into this folder"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of text")
    parser.add_argument(
        "--baseline", metavar="GROUP", help='compare all groups with this one, named as in the report: "loss=dqn"'
    )
    parser.add_argument(
        "--curves",
        type=Path,
        metavar="FILE",
        help="draw every run's learning curve into this file, a .png, .pdf or .svg",
    )
    parser.add_argument(
        "--best-lap", action="store_true", help="search for the best possible lap, and tell how far each run is from it"
    )
    parser.add_argument(
        "--bin-size",
        type=float,
        metavar="M",
        help=f"of the search, m (default: {BIN_SIZE}); half of it takes four times longer",
    )
    add_trust(parser)
    return parser


def _draw_curves(path: Path, findings: "Findings") -> None:
    from carrl.render.curves import RunCurve, draw_learning_curves  # brings Matplotlib

    first_laps = [(run.summary or {}).get("first_lap") for run in findings.runs]
    curves = {
        run.label: RunCurve(run.ends.returns, lap["episode"] if lap else None)
        for run, lap in zip(findings.runs, first_laps, strict=True)
    }
    draw_learning_curves(path, curves)
