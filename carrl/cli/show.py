"""The window of `carrl watch`, in which a network drives one car."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from carrl.cli.game import SIZE
from carrl.env.gym_env import GymTrackEnv, make_follow_picture
from carrl.evaluation.rollout import patience_of, time_limits
from carrl.render.live import hit
from carrl.render.window import Window

if TYPE_CHECKING:
    import pygame

    from carrl.train.build import SavedPolicy

HELP = (
    "N, right\tnext lap",
    "P, space\tpause",
    "H\tthis help",
    "Esc, Q\tquit",
)
"""What the keys do."""
GOLDEN = (5**0.5 - 1) / 2
"""Of a track: each lap begins so much further on, so that the places soon lie along all of it."""
HOLD_S = 1.5
"""How long the end of a lap is shown."""


class Show:
    """A window in which a network drives, lap after lap from places along the track, the first from the start line.

    Args:
        env: whose car it is.
        load: gives the network, before each lap.
        fps: time steps a second.
        live: whether the network changes.
        instead: what needs no display, for the message where there is none.

    Raises:
        CarrlError: there is no network, no display, or no pygame.
    """

    def __init__(
        self, env: GymTrackEnv, load: Callable[[], "SavedPolicy"], fps: float, live: bool, instead: str
    ) -> None:
        """Opens the window."""
        self._env, self._load, self._fps, self._live = env, load, fps, live
        self._picture = make_follow_picture(env.task, SIZE)
        self._observation = np.empty(0)
        self._laps: list[str] = []
        self._runs, self._paused, self._shows_help = True, False, False
        self._number, self._gates, self._last_gate, self._end, self._left = 0, 0, 0, "", 0
        self._begin_lap()
        self._window = Window(SIZE, f"CarRL: {env.task.simulator.track.name}", instead)

    def play(self) -> list[str]:
        """Shows laps until the person quits; returns how each went."""
        import pygame

        while self._runs:
            self._window.show(self._picture.draw(self._env.snapshot(), self._message(), self._caption), self._fps)
            for event in pygame.event.get():
                self._take(event)
            if self._runs and not (self._paused or self._shows_help):
                self._go_on()
        self._note_lap("quit")
        self._window.close()
        return self._laps

    def _take(self, event: "pygame.event.Event") -> None:
        """Does what a key asks for."""
        import pygame

        key = event.key if event.type == pygame.KEYDOWN else None
        if event.type == pygame.QUIT or key in (pygame.K_ESCAPE, pygame.K_q):
            self._runs = False
        elif key == pygame.K_h:
            self._shows_help = not self._shows_help
        elif key in (pygame.K_p, pygame.K_SPACE):
            self._paused, self._shows_help = not (self._paused or self._shows_help), False
        elif key in (pygame.K_n, pygame.K_RIGHT):
            self._paused = self._shows_help = False
            self._note_lap("left")
            self._begin_lap()

    def _go_on(self) -> None:
        """Makes a step or, where a lap has ended, waits for the next one."""
        if self._left:
            self._left -= 1
            if not self._left:
                self._begin_lap()
            return
        with torch.no_grad():
            action: Any = self._saved.policy(torch.from_numpy(self._observation)[None])[0].numpy()
        self._observation, *_ = self._env.step(action)
        scene = self._env.snapshot()
        gates = self._env.task.simulator.track.gate_count
        if scene.gates_passed > self._gates:
            self._gates, self._last_gate = scene.gates_passed, scene.step
        if scene.collided:
            self._finish(hit(scene.hit_car))
        elif scene.gates_passed >= gates:
            self._finish("lap complete")
        elif scene.step >= self._time_limit or scene.step - self._last_gate >= self._patience:
            self._finish("came no further")

    def _begin_lap(self) -> None:
        self._saved = self._load()
        simulator = self._env.task.simulator
        share = self._number * GOLDEN % 1
        station = share * simulator.track.length
        self._place = f"{share:.0%} of the way" if share else "the start line"
        if self._env.task.has_opponents:  # who are at their places, and so is the car, behind them
            station, self._place = 0.0, "behind the others"
        self._observation, _ = self._env.reset(options=None if self._env.task.has_opponents else {"station": station})
        cars = simulator.start(torch.tensor([station], dtype=torch.float64))
        self._time_limit, self._patience = int(time_limits(simulator, cars)), int(patience_of(simulator, cars))
        self._number, self._gates, self._last_gate, self._end, self._left = self._number + 1, 0, 0, "", 0
        saved = f"saved after {self._saved.frames:,} env steps"
        network = f"newest network, {saved}" if self._live else f"best network, {saved}"
        self._caption = f"lap {self._number} from {self._place}, {network}, H: help"

    def _finish(self, end: str) -> None:
        self._note_lap(end)
        self._end, self._left = end, max(1, round(HOLD_S * self._fps))

    def _note_lap(self, end: str) -> None:
        """Notes how the lap went, once."""
        scene = self._env.snapshot()
        if self._end or not scene.step:
            return
        self._end = end
        seconds = scene.step * self._env.task.simulator.vehicle.time_step
        self._laps.append(
            f"lap {self._number} from {self._place}: {end} after {scene.step} steps, {seconds:.1f} s, "
            f"reward {scene.episode_return:,.0f}, network of {self._saved.frames:,} env steps"
        )

    def _message(self) -> tuple[str, ...]:
        """What stands across the picture."""
        if self._shows_help:
            return ("watch", *HELP)
        if self._paused:
            return ("pause", "P\tgo on", "N\tnext lap", "H\thelp")
        return (self._end,) if self._end else ()
