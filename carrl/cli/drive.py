"""`carrl drive`: the driving task for a person at the keyboard."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.parser import Parser, add_trust, check_fps
from carrl.errors import ConfigError
from carrl.render.window import check_can_open
from carrl.tracks.names import check_may_exist
from carrl.train.files import load_config

if TYPE_CHECKING:
    from carrl.env.gym_env import GymTrackEnv
    from carrl.task.task import World

SEEN = 50.0
"""How far a car of another kind than the paper's sees, m: a picture shows a little more."""
CARS = 4
"""In a race, unless another number is asked for."""
BY_HAND = {"_target_": "carrl.task.action.ContinuousActions"}
"""The actions of a person who drives a car with pedals."""


def main(argv: list[str]) -> int:
    """Lets a person drive and prints what came of it."""
    arguments = _parser().parse_args(argv)
    config = _check(arguments)
    import torch  # From here on it takes seconds.

    from carrl.cli.game import Game

    torch.set_num_threads(1)
    env = _make_env(arguments, config)
    vehicle = env.task.simulator.vehicle
    fps = 1 / vehicle.time_step if arguments.fps is None else arguments.fps
    for number, attempt in enumerate(Game(env, fps).play(), start=1):
        print(f"attempt {number}: {attempt}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="carrl drive", description="Drive a track yourself, by keyboard or gamepad; H shows the keys.")
    parser.add_argument("--track", metavar="NAME|FILE", help="default: the run's, or without a run paper")
    car = parser.add_mutually_exclusive_group()
    car.add_argument("--run", metavar="RUN", help="the folder of a run, whose car, sensor, reward and track to take")
    car.add_argument("--vehicle", metavar="NAME", help="another car than the paper's, such as kinematic")
    parser.add_argument("--opponents", metavar="NAME", help="others to race against, such as line or rule")
    parser.add_argument("--cars", type=int, metavar="K", help="cars in the race, you included; default: 4")
    parser.add_argument("--fps", type=float, metavar="F", help="time steps a second; default: real time")
    add_trust(parser)
    return parser


def _check(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """The configuration of another car than the paper's, if one is asked for.

    Raises:
        CarrlError: a flag cannot be done as asked, or nothing here can open a window.
    """
    check_fps(arguments.fps)
    if arguments.run is not None and arguments.opponents is not None:
        raise ConfigError("--opponents has no effect beside --run, which has its own; leave one of them out")
    if arguments.run is None and arguments.trust:
        raise ConfigError("--trust has no effect without --run; add that, or leave it out")
    if arguments.track is not None:
        check_may_exist(arguments.track)
    if arguments.cars is not None and arguments.opponents is None:
        raise ConfigError("--cars has no effect without --opponents; add that, or leave it out")
    config = None
    if arguments.run is not None:
        config = load_config(Path(arguments.run), arguments.trust)
    elif arguments.vehicle is not None or arguments.opponents is not None:
        from carrl.train.composition import composed  # brings Hydra

        config = composed(_overrides(arguments))
    check_can_open()
    return config


def _overrides(arguments: argparse.Namespace) -> list[str]:
    """Of the default configuration, for what is asked for."""
    overrides = []
    if arguments.vehicle is not None:
        overrides += [f"vehicle={arguments.vehicle}", f"sensor.max_range={SEEN}"]
    if arguments.opponents is not None:
        cars = CARS if arguments.cars is None else arguments.cars
        overrides += [f"opponents={arguments.opponents}", f"env.cars_per_world={cars}"]
    return overrides


def _make_env(arguments: argparse.Namespace, config: dict[str, Any] | None) -> "GymTrackEnv":
    from carrl.config import build_node
    from carrl.env.gym_env import GymTrackEnv
    from carrl.train.build import build_world

    if config is None:
        return GymTrackEnv(arguments.track or "paper", render_mode="rgb_array")
    vehicle = build_node("vehicle", config["vehicle"])
    if vehicle.control_names != ("steer",):  # a person has pedals, whatever the run's actions are
        config = config | {"action": BY_HAND}
    world = build_world(config)
    return GymTrackEnv(
        arguments.track or world.track,
        render_mode="rgb_array",
        vehicle=world.vehicle,
        sensor=world.sensor,
        action=world.action,
        observation=world.observation,
        reward=world.reward,
        **among(world),
    )


def among(world: "World") -> dict[str, Any]:
    """Where there are opponents, what else an environment is of: its car starts behind them."""
    if world.opponents is None:
        return {}
    from carrl.task.episode import Start

    start = Start(gap=world.gap, order="last")
    return {"cars_per_world": world.cars_per_world, "opponents": world.opponents, "start": start, "end": world.end}
