"""The driving task for Gymnasium's vector interface: any number of cars in one simulator, NumPy in and NumPy out.

Shapes: `N` cars, `K` of them, `R` rays.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from carrl.env.gym_env import (
    RENDER_MODES,
    action_space,
    allowed_actions,
    check_options,
    check_render_mode,
    observation_space,
)
from carrl.env.random_streams import CarStreams
from carrl.env.task import Begun, StepResult, Task, Tracks, make_task
from carrl.errors import ConfigError
from carrl.sim.vehicle import Vehicle

if TYPE_CHECKING:
    from carrl.env.rendering import FleetPicture, Window

Bools = NDArray[np.bool_]
Step = tuple[np.ndarray, np.ndarray, Bools, Bools, dict[str, Any]]


class GymVectorTrackEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N cars: `gymnasium.make_vec("carrl/Track-v0", num_envs=N, track=...)` after `import carrl`.

    It does what N copies of `GymTrackEnv` in Gymnasium's `SyncVectorEnv` do, seeds included, but moves all cars at
    once. Where a sensor has noise, or the track is drawn from several, they may draw other numbers than the copies; the
    same seed gives the same rollout in any case.

    Args:
        track: what all cars drive on; or a list of tracks, of which car i drives on number i modulo their number.
        num_envs: how many cars, N.
        max_episode_steps: length at which an episode is truncated, steps; also where that step is a collision, as with
            Gymnasium's time limit.
        autoreset_mode: when a car whose episode ended is put back to the start: by its "NextStep", whose action is
            ignored and whose reward is 0; in the "SameStep", with the last view in `infos["final_obs"]`; or by
            `reset` with `options={"reset_mask": ...}` alone, "Disabled".
        render_mode: "rgb_array" or "human", as in `GymTrackEnv`; `render` shows all cars of the first track on one
            picture, and returns a tuple with that picture alone.
        options: those of `GymTrackEnv`.

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter is out of its range or has no such name, or pygame is not installed and a render mode
            needs it.
    """

    metadata = {  # noqa: RUF012 (Gymnasium's own convention)
        "render_modes": RENDER_MODES,
        "render_fps": 1 / Vehicle.time_step,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        track: Tracks = "paper",
        num_envs: int = 1,
        *,
        max_episode_steps: int = 1000,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Builds the simulator and declares the spaces."""
        check_options(options, ("num_envs", "max_episode_steps", "autoreset_mode"))
        check_render_mode(render_mode)
        self.task = make_task(track, num_envs, max_steps=max_episode_steps, **options)
        self.task.streams = self._streams = CarStreams(num_envs)
        self.num_envs, self.render_mode, self.autoreset_mode = num_envs, render_mode, _autoreset_mode(autoreset_mode)
        fps = 1 / self.task.simulator.vehicle.time_step
        self.metadata = self.metadata | {"render_fps": fps, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._first_start = self.task.start() if self.task.starts_alike else None
        self._now: Begun | None = None
        self._ended = np.zeros(num_envs, dtype=bool)
        self._track_names = np.array([each.name for each in self.task.simulator.tracks], dtype=object)
        self._picture = _make_fleet_picture(self.task) if render_mode else None
        self._window: Window | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Puts the cars at the start, all or those of `options["reset_mask"]`, [N], bool.

        Args:
            seed: for car i `seed` + i, or its own of a list; None leaves its random numbers as they are.
            options: nothing else than the mask.

        Raises:
            ConfigError: there are not N seeds, or the mask is none.
        """
        wanted = self._reset_mask((options or {}).get("reset_mask"))
        if self._now is None and not wanted.all():
            raise ResetNeeded("reset all cars before the first reset of some")
        seeds = self._seeds(seed)
        if isinstance(seed, int):
            super().reset(seed=seed)
        self._streams.seed_each(seeds, torch.from_numpy(wanted))
        self._now = now = self._put(self._now, wanted)
        self._ended = self._ended & ~wanted
        if self.render_mode == "human":
            self.render()
        return now.observation.numpy().copy(), _with_masks(self._places(now), wanted)

    def step(self, actions: np.ndarray) -> Step:
        """Drives every car one time step: actions [N] to observations, rewards, terminated, truncated and infos.

        Raises:
            InvalidAction: these are not N actions.
            ResetNeeded: there was no reset, or with `autoreset_mode` "Disabled" none for a car whose episode ended.
        """
        if self._now is None:
            raise ResetNeeded("call reset before the first step")
        taken = self._checked(actions)
        resetting = self._ended
        if resetting.any():
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise ResetNeeded(f"car {resetting.argmax()} has ended its episode; reset it with a reset_mask")
            self._now = self._put(self._now, resetting)  # A car in a wall could not be driven on.
        after = self.task.step(self._now.state, taken)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            outcome = self._end_in_same_step(after)
        else:
            outcome = self._end_in_next_step(after, resetting)
        if self.render_mode == "human":
            self.render()
        return outcome

    def render(self) -> tuple[np.ndarray] | None:
        """One picture of the cars on the first track.

        Raises:
            ConfigError: there is no display for a window.
        """
        from carrl.env.rendering import Window, pixels

        if self._picture is None:
            raise ConfigError(f"there is no render_mode; choose one of {', '.join(RENDER_MODES)} to see something")
        if self._now is None:
            raise ResetNeeded("call reset before the first picture")
        shown = self._now.state.cars.track.numpy() == 0
        cars = f"{shown.sum():,} of {self.num_envs:,} cars" if not shown.all() else f"{self.num_envs:,} cars"
        title = f"{self._track_names[0]}: {cars}"
        picture = self._picture.draw(self._now.state.cars.pose.double().numpy()[shown], self._ended[shown], title)
        if self.render_mode == "rgb_array":
            return (pixels(picture),)
        self._window = self._window or Window(picture.get_size(), "CarRL")
        self._window.show(picture, self.metadata["render_fps"])
        return None

    def close_extras(self, **_: Any) -> None:
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()
        self._window = None

    def _end_in_next_step(self, after: StepResult, resetting: Bools) -> Step:
        """What the step brought, but for the cars that it was to put back to the start."""
        now, terms, terminated = Begun(after.state, after.observation), after.reward_terms, after.terminated
        truncated = self._is_last_step(now)
        driven = ~resetting
        if resetting.any():
            assert self._now is not None
            keep, reset = torch.from_numpy(driven), torch.from_numpy(resetting)
            now = now.replacing(reset, self._now[reset])
            terms, terminated, truncated = terms * keep[:, None], terminated & keep, truncated & keep
        self._now = now
        ends = terminated.numpy(), truncated.numpy()
        self._ended = ends[0] | ends[1]
        infos = _with_masks(self._places(now), np.ones_like(driven)) | _with_masks(_by_name(self.task, terms), driven)
        return now.observation.numpy().copy(), _rewards(terms), *ends, infos

    def _end_in_same_step(self, after: StepResult) -> Step:
        """What the step brought; cars whose episode ended are at the start again, their end is in the infos."""
        now, terms, terminated = Begun(after.state, after.observation), after.reward_terms, after.terminated
        ends = terminated.numpy(), self._is_last_step(now).numpy()
        ended = ends[0] | ends[1]
        last_view, last_info = now.observation.numpy(), self._places(now) | _by_name(self.task, terms)
        self._now = now = self._put(now, ended) if ended.any() else now
        everyone = np.ones_like(ended)
        infos = _with_masks(self._places(now), everyone) | _with_masks(_by_name(self.task, terms), ~ended)
        if ended.any():
            final_views = np.full(self.num_envs, None, dtype=object)
            for car in ended.nonzero()[0]:
                final_views[car] = last_view[car].copy()
            infos |= {"final_obs": final_views, "_final_obs": ended}
            infos |= {"final_info": _with_masks(last_info, ended), "_final_info": ended.copy()}
        return now.observation.numpy().copy(), _rewards(terms), *ends, infos

    def _is_last_step(self, now: Begun) -> Tensor:
        """Whether the time limit is reached, [N], bool."""
        return now.state.step >= self.task.max_steps

    def _put(self, now: Begun | None, wanted: Bools) -> Begun:
        """The wanted cars [N] at the start of new episodes."""
        cars, first = torch.from_numpy(wanted), self._first_start
        start = first[cars] if first else self.task.start(cars)
        return start if now is None or wanted.all() else now.replacing(cars, start)

    def _places(self, now: Begun) -> dict[str, np.ndarray]:
        """Where the cars are and how far they came."""
        state = now.state.cars
        return {
            "pose": state.pose.numpy().copy(),
            "gates_passed": state.gates_passed.numpy().copy(),
            "track": self._track_names[state.track.numpy()],
        }

    def _checked(self, actions: np.ndarray) -> Tensor:
        """A copy of the actions [N], int64."""
        space = self.single_action_space
        taken = np.array(actions, dtype=space.dtype)
        low, high = (0, space.n - 1) if isinstance(space, Discrete) else (-1, 1)
        if taken.shape != self.action_space.shape or not (low <= taken.min() and taken.max() <= high):
            raise InvalidAction(f"actions must be those of {self.num_envs} cars, each {allowed_actions(self.task)}")
        return torch.from_numpy(taken)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        seeds = [seed + car for car in range(self.num_envs)] if isinstance(seed, int | np.integer) else list(seed)
        if len(seeds) != self.num_envs:
            raise ConfigError(
                f"seed has {len(seeds)} entries; it must be a number, or one for each of {self.num_envs} cars"
            )
        return seeds

    def _reset_mask(self, mask: Any) -> Bools:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if not (isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (self.num_envs,) and mask.any()):
            raise ConfigError(f"reset_mask is {mask!r}; it must be a bool array [{self.num_envs}] with a true value")
        return mask.copy()


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        names = ", ".join(each.value for each in AutoresetMode)
        raise ConfigError(f"autoreset_mode is {mode!r}; choose one of {names}") from error


def _by_name(task: Task, terms: Tensor) -> dict[str, np.ndarray]:
    """Terms of the reward [N, K], each on its own, [N], float64."""
    return dict(zip(task.reward.term_names, terms.double().numpy().T.copy(), strict=True))


def _rewards(terms: Tensor) -> np.ndarray:
    return terms.sum(dim=-1).double().numpy()


def _with_masks(values: dict[str, np.ndarray], cars: Bools) -> dict[str, Any]:
    """Gymnasium's form of infos: beside each of the values [N, ...] which cars [N] have it; zero or None for others."""
    infos: dict[str, Any] = {}
    for name, value in values.items():
        if not cars.all():
            value[~cars] = None if value.dtype == object else 0
        infos[name], infos[f"_{name}"] = value, cars.copy()
    return infos


def _make_fleet_picture(task: Task) -> "FleetPicture":
    from carrl.env.rendering import FleetPicture

    return FleetPicture(task.simulator.track, task.simulator.vehicle.body_radius)
