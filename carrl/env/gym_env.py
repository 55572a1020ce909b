"""The driving task for Gymnasium: one car, NumPy in and NumPy out.

Shapes: `R` rays.
"""

import inspect
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch

from carrl.env.task import UNLIMITED, Begun, Task, Tracks, make_task
from carrl.errors import ConfigError
from carrl.sim.vehicle import Vehicle

if TYPE_CHECKING:
    from carrl.env.rendering import CarLook, FollowPicture, Scene, Window

OPTIONS = tuple(
    name
    for name, parameter in inspect.signature(make_task).parameters.items()
    if parameter.kind is parameter.KEYWORD_ONLY and name != "max_steps"
)
"""Names of the options that an environment hands on to its task."""
RENDER_MODES = ["human", "rgb_array"]
_TRAIL_STEPS = 150


class GymTrackEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One car on a track: `gymnasium.make("carrl/Track-v0", track=...)` after `import carrl`.

    The same task as `TrackEnv` with one car. As in all of Gymnasium's own environments it is `gymnasium.make` that
    truncates episodes, at 1,000 steps or at its `max_episode_steps`, so that an episode whose last step is a collision
    is both terminated and truncated.

    Observations are distances along each ray / range, [R], float32, in [0, 1], right to left, unless
    `observation` says otherwise. Actions are 0 forward, 1 left, 2 right, unless `action` says otherwise. `info` holds
    `pose` (x m, y m, heading rad), `gates_passed`, `track` (the name of the one it drives on), and after a step the
    reward's terms by name.

    Args:
        track: a track, or what `Track.load` takes, or a list of such.
        render_mode: "rgb_array": `render` returns a picture, [480, 640, 3], uint8, and needs no display. "human": a
            window shows each step for as long as it takes to drive. None: nothing is drawn.
        options: those of `TrackEnv`, from `vehicle` on, but for `max_steps`.

    Raises:
        TrackError: the track cannot be loaded.
        ConfigError: a parameter is out of its range or has no such name, or pygame is not installed and a render mode
            needs it.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 1 / Vehicle.time_step}  # noqa: RUF012 (Gymnasium's way)

    def __init__(self, track: Tracks = "paper", *, render_mode: str | None = None, **options: Any) -> None:
        """Builds the simulator and declares the spaces."""
        check_options(options)
        check_render_mode(render_mode)
        self.task = make_task(track, max_steps=UNLIMITED, **options)  # Gymnasium's own time limit truncates
        self.metadata = self.metadata | {"render_fps": 1 / self.task.simulator.vehicle.time_step}
        self.render_mode = render_mode
        self.observation_space = observation_space(self.task)
        self.action_space = action_space(self.task)
        self._start = self.task.start() if self.task.starts_alike else None
        self._now: Begun | None = None
        self._track_names = [each.name for each in self.task.simulator.tracks]
        self._return, self._collided = 0.0, False
        self._trail: deque[np.ndarray] = deque(maxlen=_TRAIL_STEPS)
        self._picture = make_follow_picture(self.task) if render_mode else None
        self._window: Window | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Puts the car at the start."""
        super().reset(seed=seed)
        if seed is not None:
            self.task.streams.seed(seed)
        self._now = now = self._start or self.task.start()
        self._return, self._collided = 0.0, False
        self._trail.clear()
        if self.render_mode == "human":
            self.render()
        return now.observation.numpy()[0].copy(), self._info(now)

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drives one time step; terminates on a collision and never truncates by itself.

        Raises:
            ResetNeeded: there was no reset.
            InvalidAction: there is no such action.
        """
        before = self._now
        if before is None:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        if not self.action_space.contains(action):
            raise gymnasium.error.InvalidAction(f"action is {action}; it must be {allowed_actions(self.task)}")
        after = self.task.step(before.state, torch.as_tensor(np.asarray(action))[None])
        self._now = now = Begun(after.state, after.observation)
        terms = after.reward_terms
        info = self._info(now) | dict(zip(self.task.reward.term_names, terms.tolist()[0], strict=True))
        reward, collided = float(terms.sum().item()), bool(after.terminated.item())
        self._return, self._collided = self._return + reward, collided
        if self.render_mode is not None:
            self._trail.append(before.state.cars.pose.numpy()[0, :2])
            if self.render_mode == "human":
                self.render()
        return now.observation.numpy()[0].copy(), reward, collided, False, info

    def scene(self) -> "Scene":
        """What a picture of this moment shows; its trail is empty unless there is a render mode."""
        from carrl.env.rendering import Scene

        if self._now is None:
            raise gymnasium.error.ResetNeeded("call reset before the first picture")
        state, cars = self._now.state, self._now.state.cars
        return Scene(
            pose=cars.pose.double().numpy()[0],
            readings=self._readings(),
            next_gate=int(cars.next_gate),
            gates_passed=int(cars.gates_passed),
            step=int(state.step),
            steer=self._steer(state.last_action),
            action=self._action_name(state.last_action),
            episode_return=self._return,
            collided=self._collided,
            trail=list(self._trail),
            track=int(cars.track),
        )

    def render(self) -> np.ndarray | None:
        """A picture of this moment as the render mode wants it.

        Raises:
            ConfigError: there is no display for a window.
        """
        from carrl.env.rendering import Window, pixels

        if self._picture is None:
            raise ConfigError(f"there is no render_mode; choose one of {', '.join(RENDER_MODES)} to see something")
        picture = self._picture.draw(self.scene())
        if self.render_mode == "rgb_array":
            return pixels(picture)
        self._window = self._window or Window(picture.get_size(), "CarRL")
        self._window.show(picture, self.metadata["render_fps"])
        return None

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()
        self._window = None

    def _readings(self) -> np.ndarray:
        """What the rays read, [R], in 0..1; the true distances where the driver is not told them."""
        assert self._now is not None
        begin = 0
        for part in self.task.observation_parts:
            if part.name == "rays":
                return self._now.observation.double().numpy()[0, begin : begin + part.width]
            begin += part.width
        ranges = self.task.simulator.sense(self._now.state.cars)
        return ranges.double().numpy()[0] / self.task.simulator.sensor.max_range

    def _steer(self, action: torch.Tensor) -> float:
        """How far the wheel is turned, -1 to 1; 0 for a car that is not steered."""
        names = self.task.simulator.vehicle.control_names
        return float(self.task.action.controls(action)[0, names.index("steer")]) if "steer" in names else 0.0

    def _action_name(self, action: torch.Tensor) -> str:
        if self.task.action.names:
            return self.task.action.names[int(action)]
        return " ".join(f"{value:+.2f}" for value in action[0].tolist())

    def _info(self, now: Begun) -> dict[str, Any]:
        return {
            "pose": now.state.cars.pose.numpy()[0].copy(),
            "gates_passed": now.state.cars.gates_passed.item(),
            "track": self._track_names[int(now.state.cars.track.item())],
        }


def observation_space(task: Task) -> gymnasium.spaces.Box:
    """Of one car."""
    low, high = (
        [bound for part in task.observation_parts for bound in [getattr(part, name)] * part.width]
        for name in ("low", "high")
    )
    return gymnasium.spaces.Box(np.array(low, np.float32), np.array(high, np.float32))


def action_space(task: Task) -> gymnasium.Space[Any]:
    """Of one car: discrete, or a number for each control."""
    if task.action.names:
        return gymnasium.spaces.Discrete(len(task.action.names))
    return gymnasium.spaces.Box(-1.0, 1.0, (len(task.action.control_names),), np.float32)


def allowed_actions(task: Task) -> str:
    """What an action must be, as the end of a sentence."""
    if not task.action.names:
        return f"a number within -1 and 1 for each of {', '.join(task.action.control_names)}"
    *others, last = (f"{number} {name}" for number, name in enumerate(task.action.names))
    return f"{', '.join(others)} or {last}" if others else last


def check_options(options: Mapping[str, Any], others: Sequence[str] = ("max_episode_steps",)) -> None:
    """Lets pass what the task knows.

    Raises:
        ConfigError: an option is none of these; the message lists them and the `others` that the environment has.
    """
    unknown = [name for name in options if name not in OPTIONS]
    if unknown:
        names = ", ".join(("track", "render_mode", *others, *OPTIONS))
        raise ConfigError(f"there is no option {unknown[0]!r}; choose from {names}")


def check_render_mode(render_mode: str | None) -> None:
    """Lets pass one of `RENDER_MODES` or None.

    Raises:
        ConfigError: it is something else.
    """
    if render_mode not in (None, *RENDER_MODES):
        raise ConfigError(f"render_mode is {render_mode!r}; choose one of {', '.join(RENDER_MODES)}, or leave it out")


def make_follow_picture(task: Task, size: tuple[int, int] | None = None) -> "FollowPicture":
    """What draws scenes of a task, of the usual size unless one is asked for.

    Raises:
        ConfigError: pygame is not installed.
    """
    from carrl.env.rendering import SIZE, FollowPicture

    return FollowPicture(task.simulator.tracks, _look(task), size or SIZE)


def _look(task: Task) -> "CarLook":
    from carrl.env.rendering import CarLook

    simulator = task.simulator
    return CarLook(
        body_radius=simulator.vehicle.body_radius,
        speed=simulator.vehicle.step_length / simulator.vehicle.time_step,
        time_step=simulator.vehicle.time_step,
        sensor_angles=simulator.sensor_angles.double().numpy(),
        sensor_range=simulator.sensor.max_range,
    )
