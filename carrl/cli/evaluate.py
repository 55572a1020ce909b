"""`carrl evaluate`: drives a trained policy, or a baseline, on any track, with a hand-written rule beside it."""

import argparse
import json
import logging
import math
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import torch

from carrl.cli.parser import Parser, add_trust
from carrl.cli.text.console import warn
from carrl.cli.text.lap_times import print_lap_times
from carrl.cli.text.many_runs import print_table
from carrl.errors import ConfigError, printable
from carrl.racing.kept_laps import minimum_lap_times
from carrl.train.experiment import road_warning
from carrl.train.run import PolicyName, Run, load_tracks
from carrl.train.untrained import Untrained

HEADER = (
    "laps",
    "95 %",
    "progress",
    "collisions / km",
    "95 %",
    "lap reward",
    "steps",
)
"""Before the figures of `STYLES` that there are."""
STYLES = {
    "forward_share": ("forward share", 100, 0, "%"),
    "switches_per_100m": ("switches / 100 m", 1, 1, ""),
    "mean_speed": ("mean speed, m/s", 1, 1, ""),
    "steering_change": ("steering change", 1, 3, ""),
}
"""How a car was driven: heading, scale, digits and unit of each figure."""

AUTO = "auto"
"""Instead of limits: they are found."""

Figures = Mapping[str, Any]


def main(argv: list[str]) -> int:
    """Prints rows for each track, or one JSON document."""
    arguments = _parser().parse_intermixed_args(argv)
    if arguments.checkpoint and arguments.policy != "greedy":
        raise ConfigError(f"--checkpoint has no effect on --policy {arguments.policy}; leave one of them out")
    torch.set_num_threads(1)
    run, name = _run(arguments)
    world = run.world
    tracks, refused = load_tracks(arguments.track)
    for path, reason in refused.items():
        print(printable(f"warning: left out '{path}': {reason}"), file=sys.stderr)
    warn(road_warning(tracks or world.circuits.validation, world))
    _show_searches()
    limits = _limits(arguments.limit)
    if AUTO in arguments.limit:
        circuits = tracks or world.circuits.validation
        limits |= minimum_lap_times([track for track in circuits if track.name not in limits], world.vehicle)
    document = run.evaluate(
        tracks,
        arguments.starts,
        arguments.policy,
        arguments.checkpoint or "best",
        arguments.laps,
        limits=limits,
        speed_trace=arguments.speed_trace,
    )
    document |= {"run": name, **({"refused": refused} if refused else {})}
    if arguments.json:
        print(json.dumps(document, indent=2))
    else:
        print_evaluation(document)
    return 0


def _run(arguments: argparse.Namespace) -> tuple[Run, str]:
    """What is to be evaluated, and its name for readers.

    Raises:
        ConfigError: it is neither one run nor, for a baseline, a configuration.
    """
    words = arguments.run
    if words and (os.path.isdir(words[0]) or "=" not in words[0]):
        if len(words) > 1:
            raise ConfigError(f"'{words[1]}' has no effect beside a run, which has its own car; leave it out")
        return Run.load(words[0], arguments.trust), words[0]
    if arguments.policy == "greedy":
        raise ConfigError("there is no RUN whose policy could be driven; name its folder, or choose a --policy")
    if arguments.trust:
        raise ConfigError("--trust has no effect without RUN: what is typed is trusted; leave it out")
    for word in words:
        if arguments.track and word.startswith("track"):
            raise ConfigError(f"{word} has no effect beside --track; leave one of them out")
    return Untrained(arguments.policy, words), " ".join(words) or "the default car"


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl evaluate",
        description="Drives a run's policy without exploration, and a hand-written rule with the same car and sensors.",
    )
    parser.add_argument(
        "run",
        nargs="*",
        metavar="RUN|KEY=VALUE",
        help="the folder of a run, or of a run of several seeds for all of them; or, for a baseline without a run, the "
        "car, sensors and track as carrl train takes them, such as vehicle=kinematic",
    )
    parser.add_argument(
        "--track",
        action="append",
        default=[],
        metavar="NAME|FILE|FOLDER",
        help="a folder stands for all circuits in it; default: where the run was tried out; may be repeated",
    )
    parser.add_argument("--starts", type=int, default=1, metavar="N", help="start places, spread along the track")
    parser.add_argument(
        "--laps", type=int, default=1, metavar="N", help="laps in a row, of which the last, a flying lap, is measured"
    )
    parser.add_argument(
        "--limit",
        action="append",
        default=[],
        metavar="TRACK=SECONDS|auto",
        help="the least time for a flying lap there, to compare lap times with; auto finds that of this car, or reads "
        "it from the cache, for all tracks that none is given for (pip install 'carrl[racing]'); may be repeated",
    )
    parser.add_argument(
        "--speed-trace", metavar="FILE.csv", help="write time, place and speed at each step of the measured laps"
    )
    parser.add_argument(
        "--policy",
        choices=get_args(PolicyName),
        default="greedy",
        help="the run's own, greedy; or a baseline, which needs no run: rule and random for every car, follow_the_gap "
        "for F1TENTH's, by its rays, and line for vehicle=single_track with brush tyres, which knows the map and "
        "follows a line that is found with CasADi (pip install 'carrl[racing]')",
    )
    parser.add_argument("--checkpoint", choices=("best", "last"), help="which of the run's networks (default: best)")
    add_trust(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    return parser


def _limits(texts: Sequence[str]) -> dict[str, float]:
    """The limits of tracks as typed.

    Raises:
        ConfigError: one is not written as TRACK=SECONDS, or there are two of a track.
    """
    if texts.count(AUTO) > 1:
        raise ConfigError(f"--limit {AUTO} is given twice; leave one of them out")
    limits: dict[str, float] = {}
    for text in texts:
        if text == AUTO:
            continue
        name, _, seconds = text.rpartition("=")
        try:
            limit = float(seconds)
        except ValueError:
            limit = math.nan
        if not name or math.isnan(limit):
            raise ConfigError(f"--limit is {text!r}; write it as TRACK=SECONDS, such as oval=20.5, or auto")
        if name in limits:
            raise ConfigError(f"--limit is given twice for track '{name}'; leave one of them out")
        limits[name] = limit
    return limits


def _show_searches() -> None:
    """Lets what is looked for, and takes long, be told on standard error."""
    logger = logging.getLogger("carrl.racing")
    logger.setLevel(logging.INFO)
    logger.handlers[:] = [logging.StreamHandler()]  # of today's standard error


def print_evaluation(document: Figures) -> None:
    """Prints tables of the tracks, of their lap times and, of several runs, one of these."""
    tracks, name = document["tracks"], f"{document['policy']} policy"
    everything = [document["all"], *([document["all"]["rule"]] if "rule" in document["all"] else [])]
    styles = [key for key in STYLES if any(key in figures for figures in everything)]
    header = (*HEADER, *(STYLES[key][0] for key in styles), "near-wall share")
    rows = [row for track in tracks for row in _rows(track["track"], track, styles)]
    if len(tracks) > 1:
        rows += _rows(f"all {len(tracks)} tracks", document["all"], styles)
    print_table(f"{name} of {document['run']}", ("track", *header), rows)
    runs = document.get("runs", ())
    of_seeds = [run["tracks"][0] | {"track": f"  seed {run['seed']}"} for run in runs]
    print_lap_times([*tracks, *of_seeds] if len(tracks) == 1 else tracks)
    if runs:
        print_table(f"{name} of each run, all tracks", ("seed", *header), _rows_of_runs(runs, document["all"], styles))


def _rows_of_runs(runs: Sequence[Figures], together: Figures, styles: Sequence[str]) -> list[list[str]]:
    return [*([str(run["seed"]), *_cells(run["all"], styles)] for run in runs), *_rows("all", together, styles)]


def _rows(name: str, figures: Figures, styles: Sequence[str]) -> list[list[str]]:
    """A row of the policy's figures and, where they are known, one of the rule's."""
    rows = [[name, *_cells(figures, styles)]]
    return [*rows, ["  rule", *_cells(figures["rule"], styles)]] if "rule" in figures else rows


def _cells(figures: Figures, styles: Sequence[str]) -> list[str]:
    low, high = figures["intervals"]["completion"]
    least, most = figures["intervals"]["collisions_per_km"]
    return [
        f"{figures['laps_completed']}/{figures['starts']}",
        f"{100 * low:.0f}-{100 * high:.0f}%",
        _mean(figures, "progress", 100, 1, "%"),
        f"{figures['collisions_per_km']:.3f}",
        f"{least:.3f}-{most:.3f}",
        f"{figures['lap_reward']:.0f}",
        f"{figures['lap_steps']:.0f}",
        *(_mean(figures, key, *STYLES[key][1:]) if key in figures else "-" for key in styles),
        f"{figures['near_wall_share']:.1%}" if "near_wall_share" in figures else "-",
    ]


def _mean(figures: Figures, name: str, scale: float, digits: int, unit: str) -> str:
    """A mean with half the width of its interval, if it has one."""
    interval = figures["intervals"][name]
    text = f"{scale * figures[name]:.{digits}f}"
    return f"{text}{unit}" if interval is None else f"{text}±{scale * (interval[1] - interval[0]) / 2:.{digits}f}{unit}"
