"""`carrl evaluate`: drives a trained policy, or a baseline, on any track, with a hand-written rule beside it."""

import argparse
import json
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from carrl.cli.kept_drives import add_flags, any_asked, check_flags, kept_drives
from carrl.cli.limits import asked_limits, limits_for
from carrl.cli.parser import Parser, add_trust
from carrl.errors import ConfigError, printable
from carrl.evaluation.asked import MOST_LAPS, MOST_STARTS, PolicyName, check_one_drives
from carrl.files import check_may_appear
from carrl.report.runs import RunResult, runs_of_sweep
from carrl.task.checks import whole_number
from carrl.tracks.names import check_may_exist
from carrl.train.files import load_config, seed_folders

if TYPE_CHECKING:
    from carrl.train.run import Run

HOW_FAR = ("laps", "95 % of laps", "progress", "collisions / km", "95 % of these")
HOW_WELL = ("lap reward", "steps")
"""After these come the figures of `STYLES` that there are."""
STYLES = {
    "forward_share": ("forward share", 100, 0, "%"),
    "switches_per_100m": ("switches / 100 m", 1, 1, ""),
    "mean_speed": ("mean speed, m/s", 1, 1, ""),
    "steering_change": ("steering change", 1, 3, ""),
    "overtakes_per_lap": ("overtakes / lap", 1, 2, ""),
    "places_won": ("places won", 1, 2, ""),
    "contacts_own_per_km": ("own contacts / km", 1, 3, ""),
    "contacts_others_per_km": ("others' contacts / km", 1, 3, ""),
}
"""How a car was driven, and how it fared among others: heading, scale, digits and unit of each figure."""

Figures = Mapping[str, Any]


def main(argv: list[str]) -> int:
    """Prints rows for each track, or one JSON document; for a folder of runs, a row or a document for each."""
    arguments = _parser().parse_intermixed_args(argv)
    _check_figures(arguments)
    runs = _check_what_drives(arguments)
    for track in arguments.track:
        check_may_exist(track)
    import torch  # From here on it takes seconds.

    from carrl.cli.evaluate_sweep import evaluate_sweep

    torch.set_num_threads(1)
    document = evaluate_sweep(arguments, runs) if runs else _evaluate(arguments)
    if arguments.json:
        print(json.dumps(document, indent=2))
    elif runs:
        print_sweep(document)
    else:
        print_evaluation(document)
    if not arguments.json and _names_folder(arguments.run):
        _print_next(arguments)
    return 0


def _print_next(arguments: argparse.Namespace) -> None:
    """Prints what else to do with what was evaluated."""
    from carrl.cli.text.next_steps import print_next

    place = shlex.quote(arguments.run[0])
    trust = "".join(f" --trust {shlex.quote(module)}" for module in arguments.trust)
    again = f"evaluate {place}{trust} --track serpentine --starts 8"
    print_next((again, "somewhere else, from eight places"), (f"report {place}", "how it learnt, beside others"))


def _evaluate(arguments: argparse.Namespace) -> dict[str, Any]:
    from carrl.cli.text.console import warn
    from carrl.train.experiment import road_warning
    from carrl.train.run import load_tracks

    run, name = _run(arguments)
    world = run.world
    tracks, refused = load_tracks(arguments.track)
    for path, reason in refused.items():
        print(printable(f"warning: left out '{path}': {reason}"), file=sys.stderr)
    warn(road_warning(tracks or world.circuits.validation, world))
    with kept_drives(arguments, f"{arguments.policy} policy of {name}") as kept:
        document = run.evaluate(
            tracks,
            arguments.starts,
            arguments.policy,
            arguments.checkpoint or "best",
            arguments.laps,
            limits=limits_for(arguments, tracks or world.circuits.validation, world.vehicle),
            speed_trace=arguments.speed_trace,
            log=kept.log,
        )
    others = {"refused": refused, "files": kept.files}
    return document | {"run": name, **{key: value for key, value in others.items() if value}}


def _check_figures(arguments: argparse.Namespace) -> None:
    """Raises ConfigError for a flag that cannot be done as asked; adds the limits as numbers."""
    if arguments.checkpoint and arguments.policy != "greedy":
        raise ConfigError(f"--checkpoint has no effect on --policy {arguments.policy}; leave one of them out")
    whole_number("starts", arguments.starts, 1, MOST_STARTS)
    whole_number("laps", arguments.laps, 1, MOST_LAPS)
    arguments.limits = asked_limits(arguments.limit)
    if arguments.speed_trace is not None:
        check_may_appear(arguments.speed_trace)
    check_flags(arguments)


def _check_what_drives(arguments: argparse.Namespace) -> list[RunResult]:
    """The runs of a folder of them; none where one run, or none at all, is to be evaluated.

    Raises:
        CarrlError: it is neither one run nor several nor, for a baseline, a configuration.
    """
    words = arguments.run
    if _names_folder(words):
        if len(words) > 1:
            raise ConfigError(f"'{words[1]}' has no effect beside a run, which has its own car; leave it out")
        runs = runs_of_sweep(Path(words[0]))
        of_one = "--speed-trace" if arguments.speed_trace else any_asked(arguments)
        if runs and of_one:
            raise ConfigError(f"{of_one} is of one run, and this folder holds several; name one, or leave it out")
        if arguments.policy == "greedy" and any_asked(arguments):
            check_one_drives(len(seed_folders(Path(words[0]))))
        for folder in [] if runs else seed_folders(Path(words[0])):
            load_config(folder, arguments.trust)
        return runs
    if arguments.policy == "greedy":
        raise ConfigError("there is no RUN whose policy could be driven; name its folder, or choose a --policy")
    if arguments.trust:
        raise ConfigError("--trust has no effect without RUN: what is typed is trusted; leave it out")
    for word in words:
        if arguments.track and word.startswith("track"):
            raise ConfigError(f"{word} has no effect beside --track; leave one of them out")
    return []


def _names_folder(words: Sequence[str]) -> bool:
    return bool(words) and (os.path.isdir(words[0]) or "=" not in words[0])


def _run(arguments: argparse.Namespace) -> tuple["Run", str]:
    """What is to be evaluated, and its name for readers."""
    from carrl.train.run import Run
    from carrl.train.untrained import Untrained

    words = arguments.run
    if _names_folder(words):
        return Run.load(words[0], arguments.trust), words[0]
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
        help="the folder of a run, of a run of several seeds or of a sweep, for all of them; or, for a baseline "
        "without a run, the car, sensors and track as carrl train takes them, such as vehicle=kinematic",
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
    add_flags(parser)
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


def print_evaluation(document: Figures) -> None:
    """Prints tables of the tracks, of their lap times and, of several runs, one of these; then what to type next."""
    from carrl.cli.text.lap_times import print_lap_times

    tracks, name = document["tracks"], f"{document['policy']} policy"
    styles = _styles([document])
    rows = [row for track in tracks for row in _rows(track["track"], track, styles)]
    if len(tracks) > 1:
        rows += _rows(f"all {len(tracks)} tracks", document["all"], styles)
    _print_figures(f"{name} of {document['run']}", "track", rows, styles)
    runs = document.get("runs", ())
    of_seeds = [run["tracks"][0] | {"track": f"  seed {run['seed']}"} for run in runs]
    print_lap_times([*tracks, *of_seeds] if len(tracks) == 1 else tracks)
    if runs:
        rows = _rows_of_runs(runs, document["all"], styles)
        _print_figures(f"{name} of each run, all tracks", "seed", rows, styles)
    for path, what in document.get("files", {}).items():
        print(printable(f"{path}: {what}"))


def print_sweep(document: Figures) -> None:
    """Prints a row for each run of a sweep, over all tracks, and the rule's where it drives them all alike."""
    runs = document["runs"]
    styles, rules = _styles(runs), [run["all"].get("rule") for run in runs]
    rows = [[run["run"], *_cells(run["all"], styles)] for run in runs]
    if rules[0] is not None and all(rule == rules[0] for rule in rules):
        rows.append(["rule", *_cells(rules[0], styles)])
    _print_figures(f"{document['policy']} policy of each run in {document['sweep']}", "run", rows, styles)


def _styles(documents: Sequence[Figures]) -> list[str]:
    """The keys of `STYLES` that any of these have."""
    everything = [figures for document in documents for figures in (document["all"], document["all"].get("rule", {}))]
    return [key for key in STYLES if any(key in figures for figures in everything)]


def _print_figures(title: str, first: str, rows: Sequence[Sequence[str]], styles: Sequence[str]) -> None:
    """Prints all figures."""
    from carrl.cli.text.terminal_table import print_table

    header = (first, *HOW_FAR, *HOW_WELL, *(STYLES[key][0] for key in styles), "near-wall share")
    print_table(title, header, rows)
    if any("±" in cell for row in rows for cell in row):
        print("± is half of a 95 % interval")


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
    interval = figures["intervals"].get(name)
    text = f"{scale * figures[name]:.{digits}f}"
    return f"{text}{unit}" if interval is None else f"{text}±{scale * (interval[1] - interval[0]) / 2:.{digits}f}{unit}"
