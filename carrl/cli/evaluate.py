"""`carrl evaluate`: drives a trained policy, or a baseline, on any track, with a hand-written rule beside it."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from carrl.cli.evaluation_table import print_evaluation
from carrl.env.world import World
from carrl.run.build import build_world
from carrl.run.evaluation import Drive, Policy, random_policy, rule_policy, rule_world
from carrl.run.files import load_config, seed_folders
from carrl.run.folder import load_greedy_policy
from carrl.run.plan import checked_seed
from carrl.run.survey import Survey
from carrl.run.tally import tally
from carrl.sim.circuits import circuit_files
from carrl.sim.track import Track

Laps = list[list[Drive]]
"""The drives of each track."""


def main(argv: list[str]) -> int:
    """Prints rows for each track, or one JSON document."""
    arguments = _parser().parse_args(argv)
    torch.set_num_threads(1)
    runs = seed_folders(Path(arguments.run))
    if arguments.policy != "greedy":
        runs = runs[:1]  # of which the others differ in nothing that drives
    configs = [load_config(run) for run in runs]
    world = build_world(configs[0])
    tracks = [track for name in arguments.track for track in _load_tracks(name)] or list(world.circuits.validation)
    survey = Survey(world, tracks, arguments.starts)
    policies = [
        _make_policy(arguments.policy, run, arguments.checkpoint, config, world)
        for run, config in zip(runs, configs, strict=True)
    ]
    laps = [survey.drive(policy, rule_world(world) if policy is rule_policy else world) for policy in policies]
    rule = survey.drive(rule_policy, rule_world(world)) if arguments.policy != "rule" else None
    document = {
        "run": arguments.run,
        "policy": arguments.policy,
        **_figures(tracks, laps, rule, world.vehicle.step_length),
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
    parser = argparse.ArgumentParser(
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
    parser.add_argument("--checkpoint", choices=("best", "last"), default="best", help="which of the run's networks")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    return parser


def _load_tracks(name: str) -> list[Track]:
    path = Path(name)
    return [Track.load(file) for file in circuit_files(path)] if path.is_dir() else [Track.load(name)]


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
