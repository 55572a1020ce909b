"""`carrl evaluate`: drives a trained policy, or a baseline, on any track."""

import argparse
import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import torch

from carrl.run.build import World, build_world
from carrl.run.evaluation import Drive, Policy, drive, random_policy, rule_policy
from carrl.run.folder import load_config, load_greedy_policy
from carrl.run.plan import checked_seed
from carrl.sim.simulator import Simulator
from carrl.sim.track import Track
from carrl.view.console import print_table

COLUMNS = {
    "lap_reward": "lap reward",
    "lap_steps": "steps",
    "forward_share": "forward share",
    "switches_per_100m": "switches / 100 m",
    "near_wall_share": "near-wall share",
}
"""Measures of a drive that are averaged over the start places, and their headings."""


def main(argv: list[str]) -> int:
    """Prints a row for each track, or one JSON document."""
    arguments = _parser().parse_args(argv)
    torch.set_num_threads(1)
    run = Path(arguments.run)
    config = load_config(run)
    world = build_world(config)
    tracks = [Track.load(name) for name in arguments.track] or [world.track]
    policy = _make_policy(arguments.policy, run, arguments.checkpoint, config)
    results = [_evaluate(dataclasses.replace(world, track=track), policy, arguments.starts) for track in tracks]
    if arguments.json:
        print(json.dumps({"run": str(run), "policy": arguments.policy, "tracks": results}, indent=2))
    else:
        header = ("track", "laps", "progress", *COLUMNS.values())
        print_table(f"{arguments.policy} policy of {run}", header, [_row(result) for result in results])
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="carrl evaluate", description="Drives a run's policy without exploration.")
    parser.add_argument("run", metavar="RUN", help="the folder of a run")
    parser.add_argument(
        "--track", action="append", default=[], metavar="NAME|FILE", help="default: the run's own; may be repeated"
    )
    parser.add_argument("--starts", type=int, default=1, metavar="N", help="start places, spread along the track")
    parser.add_argument("--policy", choices=("greedy", "rule", "random"), default="greedy")
    parser.add_argument("--checkpoint", choices=("best", "last"), default="best", help="which of the run's networks")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    return parser


def _make_policy(name: str, run: Path, checkpoint: str, config: dict[str, Any]) -> Policy:
    if name == "rule":
        return rule_policy
    if name == "random":
        return random_policy(checked_seed(config["seed"]))
    return load_greedy_policy(run, checkpoint, config)


def _evaluate(world: World, policy: Policy, starts: int) -> dict[str, Any]:
    simulator = Simulator(world.track, world.vehicle, world.sensor)
    drives = drive(simulator, world.reward, policy, starts)
    return {
        "track": world.track.name,
        "length_m": world.track.length,
        "starts": starts,
        "laps_completed": sum(attempt.lap_completed for attempt in drives),
        **{name: _mean(drives, name) for name in ("progress", *COLUMNS)},
        "drives": [attempt.measures() for attempt in drives],
    }


def _mean(drives: list[Drive], name: str) -> float:
    return math.fsum(getattr(attempt, name) for attempt in drives) / len(drives)


def _row(result: dict[str, Any]) -> list[str]:
    return [
        result["track"],
        f"{result['laps_completed']}/{result['starts']}",
        f"{result['progress']:.1%}",
        f"{result['lap_reward']:.0f}",
        f"{result['lap_steps']:.0f}",
        f"{result['forward_share']:.0%}",
        f"{result['switches_per_100m']:.1f}",
        f"{result['near_wall_share']:.1%}",
    ]
