"""`carrl drive`: the driving task for a person at the keyboard."""

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from carrl.cli.driver import driver_of
from carrl.cli.parser import Parser, add_trust
from carrl.config import build_node
from carrl.env.gym_env import GymTrackEnv, make_follow_picture
from carrl.errors import ConfigError
from carrl.train.build import build_world
from carrl.train.composition import composed
from carrl.train.files import load_config

if TYPE_CHECKING:
    import pygame

SIZE = (960, 720)
"""Of the window, px."""
HELP = (
    "R\tback to the start",
    "P, space\tpause",
    "H\tthis help",
    "Esc, Q\tquit",
)
"""What the other keys do."""


SEEN = 50.0
"""How far a car of another kind than the paper's sees, m: a picture shows a little more."""
BY_HAND = {"_target_": "carrl.task.action.ContinuousActions"}
"""The actions of a person who drives a car with pedals."""


@dataclass(frozen=True)
class Attempt:
    """How far one episode came.

    Attributes:
        steps: driven.
        gates: passed.
        laps: completed.
        reward: sum over the steps.
        collided: whether it ended at a wall.
    """

    steps: int
    gates: int
    laps: int
    reward: float
    collided: bool

    def __str__(self) -> str:
        """One line for the terminal."""
        end = "hit a wall" if self.collided else "stopped"
        return f"{self.steps} steps, {self.gates} gates, {self.laps} laps, reward {self.reward:,.0f}, {end}"


class Game:
    """A window in which a person drives one car; it waits for a first key.

    Args:
        env: whose car it is.
        fps: time steps a second.

    Raises:
        ConfigError: there is no display, or no pygame, or a person cannot drive the car.
    """

    def __init__(self, env: GymTrackEnv, fps: float) -> None:
        """Opens the window."""
        self._picture = make_follow_picture(env.task, SIZE)
        from carrl.render.window import Window

        self._window = Window(SIZE, f"CarRL: {env.task.simulator.track.name}")
        self._env, self._fps = env, fps
        self._attempts: list[Attempt] = []
        self._driver = driver_of(env.task.action, env.task.simulator.vehicle.time_step)
        self._runs, self._shows_help, self._paused = True, True, False
        env.reset()

    def play(self) -> list[Attempt]:
        """Drives until the person quits; returns all attempts of at least one step."""
        import pygame

        while self._runs:
            self._window.show(self._picture.draw(self._env.snapshot(), self._message()), self._fps)
            for event in pygame.event.get():
                self._take(event)
            if self._runs and not (self._shows_help or self._paused or self._env.snapshot().collided):
                self._env.step(self._driver.next_action())
        self._note_attempt()
        self._window.close()
        return self._attempts

    def _take(self, event: "pygame.event.Event") -> None:
        """Does what a key asks for."""
        import pygame

        if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key in (pygame.K_ESCAPE, pygame.K_q)):
            self._runs = False
        elif self._driver.take(event):
            self._shows_help = self._paused = False
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_h:
            self._shows_help = not self._shows_help
        elif event.type == pygame.KEYDOWN and event.key in (pygame.K_p, pygame.K_SPACE):
            self._paused, self._shows_help = not (self._paused or self._shows_help), False
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_r:
            self._note_attempt()
            self._env.reset()
            self._shows_help = self._paused = False

    def _message(self) -> tuple[str, ...]:
        """What stands across the picture."""
        if self._shows_help:
            return ("drive", *self._driver.help, *HELP, "steer, or press the up arrow, to start")
        if self._env.snapshot().collided:
            return ("hit a wall", "R\tback to the start", "Esc\tquit")
        return ("pause", "P\tgo on", "H\thelp") if self._paused else ()

    def _note_attempt(self) -> None:
        scene, gates = self._env.snapshot(), self._env.task.simulator.track.gate_count
        if scene.step:
            laps = scene.gates_passed // gates
            self._attempts.append(Attempt(scene.step, scene.gates_passed, laps, scene.episode_return, scene.collided))


def main(argv: list[str]) -> int:
    """Lets a person drive and prints what came of it."""
    arguments = _parser().parse_args(argv)
    torch.set_num_threads(1)
    env = _make_env(arguments)
    vehicle = env.task.simulator.vehicle
    fps = 1 / vehicle.time_step if arguments.fps is None else arguments.fps
    if not (math.isfinite(fps) and fps > 0):
        raise ConfigError(f"--fps is {fps}; it must be a positive number of time steps a second")
    for number, attempt in enumerate(Game(env, fps).play(), start=1):
        print(f"attempt {number}: {attempt}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="carrl drive", description="Drive a track yourself, by keyboard or gamepad; H shows the keys.")
    parser.add_argument("--track", metavar="NAME|FILE", help="default: the run's, or without a run paper")
    car = parser.add_mutually_exclusive_group()
    car.add_argument("--run", metavar="RUN", help="the folder of a run, whose car, sensor, reward and track to take")
    car.add_argument("--vehicle", metavar="NAME", help="another car than the paper's, such as kinematic")
    parser.add_argument("--fps", type=float, metavar="F", help="time steps a second; default: real time")
    add_trust(parser)
    return parser


def _make_env(arguments: argparse.Namespace) -> GymTrackEnv:
    if arguments.run is None and arguments.trust:
        raise ConfigError("--trust has no effect without --run; add that, or leave it out")
    if arguments.run is None and arguments.vehicle is None:
        return GymTrackEnv(arguments.track or "paper", render_mode="rgb_array")
    if arguments.run is None:
        config = composed([f"vehicle={arguments.vehicle}", f"sensor.max_range={SEEN}"])
    else:
        config = load_config(Path(arguments.run), arguments.trust)
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
    )
