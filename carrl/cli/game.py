"""The window of `carrl drive`, in which a person drives one car."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from carrl.cli.driver import driver_of
from carrl.env.gym_env import GymTrackEnv, make_follow_picture
from carrl.render.live import hit

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


@dataclass(frozen=True)
class Attempt:
    """How far one episode came.

    Attributes:
        steps: driven.
        gates: passed.
        laps: completed.
        reward: sum over the steps.
        collided: whether it ended at a wall or a car.
        hit_car: whether that was a car.
    """

    steps: int
    gates: int
    laps: int
    reward: float
    collided: bool
    hit_car: bool = False

    def __str__(self) -> str:
        """One line for the terminal."""
        end = hit(self.hit_car) if self.collided else "stopped"
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
        scene = self._env.snapshot()
        if scene.collided:
            return (hit(scene.hit_car), "R\tback to the start", "Esc\tquit")
        return ("pause", "P\tgo on", "H\thelp") if self._paused else ()

    def _note_attempt(self) -> None:
        scene, gates = self._env.snapshot(), self._env.task.simulator.track.gate_count
        if scene.step:
            laps = scene.gates_passed // gates
            attempt = Attempt(scene.step, scene.gates_passed, laps, scene.episode_return, scene.collided, scene.hit_car)
            self._attempts.append(attempt)
