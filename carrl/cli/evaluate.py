"""`carrl evaluate`: drives a trained policy, or a baseline, on any track, with a hand-written rule beside it."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from carrl.cli.evaluation_table import print_evaluation
from carrl.cli.parser import Parser
from carrl.cli.road_warning import warn_of_roads
from carrl.errors import ConfigError
from carrl.evaluation.results import Drive, tally
from carrl.evaluation.rollout import Policy, Survey, random_policy, rule_policy, rule_world
from carrl.printable import printable
from carrl.task.world import World
from carrl.tracks.circuits import Folder, load_folder
from carrl.tracks.track import Track
from carrl.train.build import build_world
from carrl.train.files import load_config, seed_folders
from carrl.train.folder import load_greedy_policy
from carrl.train.plan import checked_seed

Laps = list[list[Drive]]
"""The drives of each track."""


def main(argv: list[str]) -> int:
    """Prints rows for each track, or one JSON document."""
    arguments = _parser().parse_args(argv)
    if arguments.checkpoint and arguments.policy != "greedy":
        raise ConfigError(f"--checkpoint has no effect on --policy {arguments.policy}; leave one of them out")
    torch.set_num_threads(1)
    runs = seed_folders(Path(arguments.run))
    if arguments.policy != "greedy":
        runs = runs[:1]  # of which the others differ in nothing that drives
    configs = [load_config(run) for run in runs]
    world = build_world(configs[0])
    tracks, refused = _load_tracks(arguments.track)
    tracks = tracks or list(world.circuits.validation)
    warn_of_roads(tracks, world)
    survey = Survey(world, tracks, arguments.starts)
    policies = [
        _make_policy(arguments.policy, run, arguments.checkpoint or "best", config, world)
        for run, config in zip(runs, configs, strict=True)
    ]
    laps = [survey.drive(policy, rule_world(world) if policy is rule_policy else world) for policy in policies]
    rule = survey.drive(rule_policy, rule_world(world)) if arguments.policy != "rule" else None
    document = {
        "run": arguments.run,
        "policy": arguments.policy,
        **_figures(tracks, laps, rule, world.vehicle.step_length),
        **({"refused": refused} if refused else {}),
    }
    if len(runs) > 1:
        document["runs"] = [
            {"run": str(run), "seed": config["seed"], **_figures(tracks, [own], None, world.vehicle.step_length)}
            for run, config, own in zip(runs, configs, laps, strict=True)
        ]
    if arguments.json:
        print(json.dumps(document, indent=2))
    else:
        print_evaluation(document)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl evaluate",
        description="Drives a run's policy without exploration, and a hand-written rule with the same car and sensors.",
    )
    parser.add_argument("run", metavar="RUN", help="the folder of a run, or of a run of several seeds for all of them")
    parser.add_argument(
        "--track",
        action="append",
        default=[],
        metavar="NAME|FILE|FOLDER",
        help="a folder stands for all circuits in it; default: where the run was tried out; may be repeated",
    )
    parser.add_argument("--starts", type=int, default=1, metavar="N", help="start places, spread along the track")
    parser.add_argument("--policy", choices=("greedy", "rule", "random"), default="greedy")
    parser.add_argument("--checkpoint", choices=("best", "last"), help="which of the run's networks (default: best)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    return parser


def _load_tracks(names: Sequence[str]) -> tuple[list[Track], dict[str, str]]:
    """The tracks of these names, files and folders; and why files of a folder were left out, which it prints, too."""
    tracks: list[Track] = []
    refused: dict[str, str] = {}
    for name in names:
        found = load_folder(Path(name)) if Path(name).is_dir() else Folder([Track.load(name)], {})
        tracks += found.tracks
        refused |= {str(path): reason for path, reason in found.refused.items()}
    for path, reason in refused.items():
        print(printable(f"warning: left out '{path}': {reason}"), file=sys.stderr)
    return tracks, refused


def _make_policy(name: str, run: Path, checkpoint: str, config: dict[str, Any], world: World) -> Policy:
    if name == "rule":
        return rule_policy
    if name == "random":
        return random_policy(checked_seed(config["seed"]), world.action)
    return load_greedy_policy(run, checkpoint, config, world)


def _figures(tracks: Sequence[Track], runs: list[Laps], rule: Laps | None, step_length: float) -> dict[str, Any]:
    """The figures of each track and of all, each with those of the rule."""

    def beside(laps: Laps | None) -> dict[str, Any]:
        return {} if laps is None else {"rule": tally([[each for own in laps for each in own]], step_length)}

    of_tracks = [
        {
            "track": track.name,
            "length_m": track.length,
            **tally([laps[index] for laps in runs], step_length),
            "drives": [attempt.measures() for laps in runs for attempt in laps[index]],
            **beside(rule and [rule[index]]),
        }
        for index, track in enumerate(tracks)
    ]
    everything = [[each for own in laps for each in own] for laps in runs]
    return {"tracks": of_tracks, "all": {**tally(everything, step_length), **beside(rule)}}
