"""`carrl report`: lines up the results of runs."""

import argparse
from pathlib import Path

from carrl.run.report import find_runs, markdown_table
from carrl.view.learning_curve import RunCurve, draw_learning_curves


def main(argv: list[str]) -> int:
    """Prints a table in Markdown and, on demand, draws all learning curves in one picture."""
    parser = argparse.ArgumentParser(prog="carrl report", description="Compares runs.")
    parser.add_argument("directories", nargs="+", type=Path, metavar="DIR", help="a run, or a folder of runs")
    parser.add_argument("--curves", type=Path, metavar="PNG", help="draw all learning curves into this file")
    arguments = parser.parse_args(argv)
    runs = find_runs(arguments.directories)
    print(markdown_table(runs))
    if arguments.curves:
        first_laps = [(run.summary or {}).get("first_lap") for run in runs]
        curves = {
            run.label: RunCurve(run.episode_returns, lap["episode"] if lap else None)
            for run, lap in zip(runs, first_laps, strict=True)
        }
        draw_learning_curves(arguments.curves, curves)
    return 0
