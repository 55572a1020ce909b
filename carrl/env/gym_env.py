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
from gymnasium.error import InvalidAction
from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.sim.simulator import CarState
from carrl.sim.vehicle import Rectangle, Vehicle
from carrl.task.action import ActionMap, in_words
from carrl.task.checks import number, seed_number
from carrl.task.episode import EpisodeState
from carrl.task.task import UNLIMITED, EpisodeStart, Task, Tracks, make_task
from carrl.tracks.track import Track

if TYPE_CHECKING:
    from carrl.render.live import CarLook, CarSnapshot, FollowPicture
    from carrl.render.window import Window


class ActionError(ConfigError, InvalidAction):
    """Actions that there are none of: CarRL's error and Gymnasium's in one."""


def action_space(actions: ActionMap) -> gymnasium.Space[Any]:
    """Of one car: discrete, or a number for each control."""
    if actions.names:
        return gymnasium.spaces.Discrete(len(actions.names))
    return gymnasium.spaces.Box(-1.0, 1.0, (len(actions.control_names),), np.float32)


def one_action(action: Any, actions: ActionMap) -> Tensor:
    """The action of one car, [1] or [1, C]: of Python, NumPy or torch, but no bool.

    Raises:
        ActionError: there is no such action.
    """
    if type(action) in (int, np.int64):  # the usual case, quickly
        given = np.array([action])
    else:
        try:
            given = np.asarray(action)[None]
        except (TypeError, ValueError):
            given = np.array(None)
    if not _is_action(given, (1,), actions).all():
        raise ActionError(f"action is {shown(action)}; it must be {_wanted(actions)}")
    return _as_tensor(given, actions)


def many_actions(given: Any, cars: int, actions: ActionMap) -> Tensor:
    """A copy of the actions of N cars, [N] or [N, C].

    Raises:
        ActionError: they are of another shape or type, or there is no such action.
    """
    try:
        array = np.asarray(given)
    except (TypeError, ValueError) as error:  # such as a tensor on another device, or rows of several lengths
        raise ActionError(f"actions is {shown(given)}, no array; it must be {_all_wanted(cars, actions)}") from error
    are_actions = _is_action(array, (cars,), actions)
    if not are_actions.shape:
        raise ActionError(
            f"actions is an array {list(array.shape)} of {array.dtype}; it must be {_all_wanted(cars, actions)}"
        )
    if not are_actions.all():
        car = are_actions.argmin()
        raise ActionError(f"actions[{car}] is {array[car]}; actions must be {_all_wanted(cars, actions)}")
    return _as_tensor(array, actions)


def _is_action(given: np.ndarray, cars: tuple[int], actions: ActionMap) -> np.ndarray:
    """Which of the cars have an action, [N]; a single False where they are of another shape or type."""
    if actions.names:
        fits = given.dtype.kind in "iu" and given.shape == cars
        return (given >= 0) & (given < len(actions.names)) if fits else np.array(False)
    fits = given.dtype.kind in "iuf" and given.shape == (*cars, len(actions.control_names))
    return (np.abs(given) <= 1).all(axis=-1) if fits else np.array(False)  # nan fails it, too


def _as_tensor(given: np.ndarray, actions: ActionMap) -> Tensor:
    return torch.from_numpy(given.astype(np.int64 if actions.names else np.float32))


def _wanted(actions: ActionMap) -> str:
    return f"the whole number {in_words(actions)}" if actions.names else in_words(actions)


def _all_wanted(cars: int, actions: ActionMap) -> str:
    shape = [cars] if actions.names else [cars, len(actions.control_names)]
    return f"{cars} numbers in an array {shape}, each {_wanted(actions)}"


OPTIONS = tuple(
    name
    for name, parameter in inspect.signature(make_task).parameters.items()
    if parameter.kind is parameter.KEYWORD_ONLY and name != "max_steps"
)
"""Names of the options that an environment hands on to its task."""
RENDER_MODES = ["human", "rgb_array"]
_TRAIL_STEPS = 150


class OptionError(ConfigError, TypeError):
    """An option that there is none of; also a TypeError, as Python raises it for a keyword that a function lacks.

    Libraries that make environments try keywords of their own, and take that for the answer: TorchRL 0.14 goes on
    without `frameskip` if the message says what Python's says.
    """


class GymTrackEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One car on a track: `gymnasium.make("carrl/Track-v0", track=...)` after `import carrl`.

    The same task as `TrackEnv` with one car. As in all of Gymnasium's own environments it is `gymnasium.make` that
    truncates episodes, at 1,000 steps or at its `max_episode_steps`, so that an episode whose last step is a collision
    is both terminated and truncated. After a collision no step is taken until `reset`; a car that was truncated may
    drive on, as with any environment in Gymnasium's time limit.

    Observations are distances along each ray / range, [R], float32, in [0, 1], right to left, unless `observation`
    says otherwise. Actions are 0 forward, 1 left, 2 right, unless `action` says otherwise. `info` holds numbers alone,
    at a reset and after a step the same: `pose` (x m, y m, heading rad), `gates_passed`, `track` (the index into
    `tracks` of the one it drives on), and the reward's terms by name, zero after a reset.

    Args:
        track: a track, or what `Track.load` takes, or a list of such.
        render_mode: "rgb_array": `render` returns a picture, [480, 640, 3], uint8, and needs no display. "human": a
            window shows each step for as long as it takes to drive. None: nothing is drawn.
        options: those of `TrackEnv`, from `vehicle` on, but for `max_steps`.

    Raises:
        TrackError: the track cannot be loaded.
        OptionError: there is no such parameter; it is a ConfigError and a TypeError.
        ConfigError: a parameter is of another type or out of its range.
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
        self.action_space = action_space(self.task.action)
        self._start = self.task.start() if self.task.starts_alike else None
        self._now: EpisodeStart | None = None
        self._return, self._collided, self._hit_car = 0.0, False, False
        self._trail: deque[np.ndarray] = deque(maxlen=_TRAIL_STEPS)
        self._picture: FollowPicture | None = None
        self._window: Window | None = None

    def __repr__(self) -> str:
        """One line: what is driven on, and with how many rays."""
        simulator = self.task.simulator
        names = [track.name for track in self.tracks]
        track = shown(names[0] if len(names) == 1 else names)
        return f"GymTrackEnv({track}, rays={simulator.sensor.rays}, render_mode={self.render_mode!r})"

    @property
    def tracks(self) -> tuple[Track, ...]:
        """What `info["track"]` counts: the tracks given, each with its variants if there are any."""
        return self.task.simulator.tracks

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Puts the car at the start.

        Args:
            seed: of what is drawn by chance from now on.
            options: `{"station": S}` puts it on the centreline of the first track, S m behind the start line, at rest.

        Raises:
            ConfigError: the seed is no whole number, or below 0 or above 2^63 - 1; or there is no such station.
        """
        seed = None if seed is None else seed_number(seed)
        super().reset(seed=seed)
        if seed is not None:
            self.task.streams.seed(seed)
        self._now = now = self._begin(options or {})
        self._return, self._collided, self._hit_car = 0.0, False, False
        self._trail.clear()
        if self.render_mode == "human":
            self.render()
        return now.observation.numpy()[0].copy(), self._info(now, [0.0] * len(self.task.reward.term_names))

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drives one time step; terminates on a collision, or as `end` says, and never truncates by itself.

        Raises:
            ResetNeeded: there was no reset, or none since the episode ended.
            ActionError: there is no such action; it is a ConfigError and Gymnasium's InvalidAction.
        """
        before = self._now
        if before is None:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        if self._collided:
            ended = "the car has hit a wall" if bool(before.state.contact) else "one of the episode's ends has come"
            raise gymnasium.error.ResetNeeded(f"{ended}, which ended its episode; reset it")
        after = self.task.step(before.state, one_action(action, self.task.action))
        self._now = now = EpisodeStart(after.state, after.observation)
        terms = after.reward_terms
        info = self._info(now, terms.tolist()[0])
        reward, collided = float(terms.sum().item()), bool(after.terminated.item())
        self._return, self._collided = self._return + reward, collided
        self._hit_car = collided and after.outcome.contact is not None and bool(after.outcome.contact.touched)
        if self.render_mode is not None:
            self._trail.append(before.state.cars.pose.numpy()[0, :2])
            if self.render_mode == "human":
                self.render()
        return now.observation.numpy()[0].copy(), reward, collided, False, info

    def snapshot(self) -> "CarSnapshot":
        """What a picture of now shows; its trail is empty unless there is a render mode."""
        from carrl.render.live import CarSnapshot

        if self._now is None:
            raise gymnasium.error.ResetNeeded("call reset before the first picture")
        state, cars = self._now.state, self._now.state.cars
        return CarSnapshot(
            pose=cars.pose.double().numpy()[0],
            readings=self._readings(self._now),
            next_gate=int(cars.next_gate),
            gates_passed=int(cars.gates_passed),
            step=int(state.step),
            steer=self._wheel(state),
            action=self._action_name(state.last_action),
            episode_return=self._return,
            collided=self._collided,
            trail=list(self._trail),
            track=int(cars.track),
            speed=self._state_value(cars, "speed"),
            others=other_poses(self.task, cars),
            hit_car=self._hit_car,
        )

    def render(self) -> np.ndarray | None:
        """A picture of this moment as the render mode wants it.

        Raises:
            ConfigError: there is no render mode, or for a window no display or no pygame.
        """
        if self.render_mode is None:
            raise ConfigError(f"there is no render_mode; choose one of {', '.join(RENDER_MODES)} to see something")
        self._picture = self._picture or make_follow_picture(self.task)
        picture = self._picture.draw(self.snapshot())
        if self.render_mode == "rgb_array":
            return picture
        from carrl.render.window import Window

        self._window = self._window or Window(self._picture.size, "CarRL")
        self._window.show(picture, self.metadata["render_fps"])
        return None

    def _begin(self, options: Mapping[str, Any]) -> EpisodeStart:
        if "station" not in options:
            return self._start or self.task.start()
        if self.task.has_opponents:
            raise ConfigError("options has a station, and a car among opponents starts in their row; leave it out")
        simulator = self.task.simulator
        length = simulator.track.length
        station = number("station", options["station"], 0, length, f"a place on the track, from 0 to {length:g} m")
        return self.task.start_at(simulator.start(torch.tensor([station], dtype=torch.float64)))

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()
        self._window = None

    def _readings(self, now: EpisodeStart) -> np.ndarray:
        """What the rays read, [R], in 0..1; the true distances where the driver is not told them."""
        begin = 0
        for part in self.task.observation_parts:
            if part.name in ("rays", "scans"):
                return now.observation.double().numpy()[0, begin : begin + self.task.simulator.sensor.rays]
            begin += part.width
        ranges = self.task.simulator.sense(now.state.cars)
        return ranges.double().numpy()[0] / self.task.simulator.sensor.max_range

    def _state_value(self, cars: CarState, name: str) -> float | None:
        names = self.task.simulator.vehicle.state_names
        return float(cars.state[0, names.index(name)]) if name in names else None

    def _wheel(self, state: EpisodeState) -> float:
        """How far a picture is to turn the front wheels: as they stand, or where that is not known as they are told."""
        from carrl.render.car import wheel_turn

        steering = self._state_value(state.cars, "steering")
        return float(self.task.steer(state.last_action)) if steering is None else wheel_turn(steering)

    def _action_name(self, action: torch.Tensor) -> str:
        if self.task.action.names:
            return self.task.action.names[int(action)]
        digits = 2 if action.shape[-1] == 1 else 1
        return " ".join(f"{value:+.{digits}f}" for value in action[0].tolist())

    def _info(self, now: EpisodeStart, terms: list[float]) -> dict[str, Any]:
        cars = now.state.cars
        place = {
            "pose": cars.pose.numpy()[0].copy(),
            "gates_passed": cars.gates_passed.item(),
            "track": cars.track.item(),
        }
        return place | dict(zip(self.task.reward.term_names, terms, strict=True))


def other_poses(task: Task, cars: CarState) -> Sequence[np.ndarray]:
    """Of the opponents in the world of one car, [M, 3], float64; none where it is alone."""
    if not task.has_opponents or cars.others is None:
        return ()
    return list(cars.others.state[0, :, :3].double().cpu().numpy())


def observation_space(task: Task) -> gymnasium.spaces.Box:
    """Of one car."""
    low, high = task.observation_bounds
    return gymnasium.spaces.Box(low.numpy(), high.numpy())


def check_options(options: Mapping[str, Any], others: Sequence[str] = ("max_episode_steps",)) -> None:
    """Lets pass what the task knows.

    Raises:
        OptionError: an option is none of these; the message lists them and the `others` that the environment has.
    """
    unknown = [name for name in options if name not in OPTIONS]
    if unknown:
        names = ", ".join(("track", "render_mode", *others, *OPTIONS))
        raise OptionError(f"the environment got an unexpected keyword argument {unknown[0]!r} (choose from {names})")


def check_render_mode(render_mode: str | None) -> None:
    """Lets pass one of `RENDER_MODES` or None.

    Raises:
        ConfigError: it is something else.
    """
    if render_mode not in (None, *RENDER_MODES):
        raise ConfigError(f"render_mode is {render_mode!r}; choose one of {', '.join(RENDER_MODES)}, or leave it out")


def make_follow_picture(task: Task, size: tuple[int, int] | None = None) -> "FollowPicture":
    """What draws cars of a task, of the usual size unless one is asked for."""
    from carrl.render.live import SIZE, FollowPicture

    return FollowPicture(task.simulator.tracks, _look(task), size or SIZE)


def _look(task: Task) -> "CarLook":
    from carrl.render.live import CarLook

    simulator, body = task.simulator, task.simulator.vehicle.body
    return CarLook(
        body_radius=body.half_width,
        speed=simulator.vehicle.step_length / simulator.vehicle.time_step,
        time_step=simulator.vehicle.time_step,
        sensor_angles=simulator.sensor_angles.double().numpy(),
        sensor_range=simulator.sensor.max_range,
        body_size=(body.length, body.width) if isinstance(body, Rectangle) else None,
        sensor_mount=simulator.sensor.mount,
    )
