"""`carrl report`: lines up the results of runs."""

import argparse
from pathlib import Path

from carrl.run.report import best_lap_of, find_runs, markdown_table
from carrl.view.learning_curve import RunCurve, draw_learning_curves


def main(argv: list[str]) -> int:
    """Prints a table in Markdown and, on demand, draws all learning curves in one picture."""
    parser = argparse.ArgumentParser(prog="carrl report", description="Compares runs.")
    parser.add_argument("directories", nargs="+", type=Path, metavar="DIR", help="a run, or a folder of runs")
    parser.add_argument("--curves", type=Path, metavar="PNG", help="draw all learning curves into this file")
    parser.add_argument(
        "--best-lap", action="store_true", help="search for the best possible lap, and tell how far each run is from it"
    )
    parser.add_argument(
        "--bin-size",
        type=float,
        default=0.25,
        metavar="M",
        help="of the search, m; half of it takes four times longer",
    )
    arguments = parser.parse_args(argv)
    runs = find_runs(arguments.directories)
    best_lap = best_lap_of(runs, arguments.bin_size) if arguments.best_lap else None
    print(markdown_table(runs, best_lap))
    if best_lap is not None:
        print(
            f"\nThe best possible lap: {best_lap.lap_steps} steps, forward {best_lap.forward_share:.1%}, "
            f"{best_lap.switches_per_100m:.2f} switches / 100 m, {best_lap.reversals} reversals."
        )
    if arguments.curves:
        first_laps = [(run.summary or {}).get("first_lap") for run in runs]
        curves = {
            run.label: RunCurve(run.episode_returns, lap["episode"] if lap else None)
            for run, lap in zip(runs, first_laps, strict=True)
        }
        draw_learning_curves(arguments.curves, curves)
    return 0
