"""The driving task for Gymnasium's vector interface: any number of cars in one simulator, NumPy in and NumPy out.

Shapes: `N` cars, `K` of them, `R` rays.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from carrl.env.gym_env import (
    RENDER_MODES,
    action_space,
    check_options,
    check_render_mode,
    many_actions,
    observation_space,
)
from carrl.errors import ConfigError
from carrl.sim.vehicle import Vehicle
from carrl.task.checks import seed_list, seed_number
from carrl.task.random_streams import CarStreams
from carrl.task.task import EpisodeStart, StepResult, Task, Tracks, make_task
from carrl.tracks.track import Track

if TYPE_CHECKING:
    from carrl.render.live import FleetPicture
    from carrl.render.window import Window

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
        OptionError: there is no such parameter; it is a ConfigError and a TypeError.
        ConfigError: a parameter is of another type or out of its range.
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
        if self.task.shares_worlds:
            raise ConfigError(
                "the cars of gymnasium.make_vec cannot share a world; use carrl.TrackEnv or carrl.parallel_env, or let "
                "opponents drive the others"
            )
        self.task.streams = self._streams = CarStreams(num_envs)
        self.num_envs, self.render_mode, self.autoreset_mode = num_envs, render_mode, _autoreset_mode(autoreset_mode)
        fps = 1 / self.task.simulator.vehicle.time_step
        self.metadata = self.metadata | {"render_fps": fps, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task.action)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._first_start = self.task.start() if self.task.starts_alike else None
        self._now: EpisodeStart | None = None
        self._ended = np.zeros(num_envs, dtype=bool)
        self._picture: FleetPicture | None = None
        self._window: Window | None = None

    @property
    def tracks(self) -> tuple[Track, ...]:
        """What `infos["track"]` counts: the tracks given, each with its variants if there are any."""
        return self.task.simulator.tracks

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
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self._streams.seed_each(seeds, torch.from_numpy(wanted))
        self._now = now = self._put(self._now, wanted)
        self._ended = self._ended & ~wanted
        if self.render_mode == "human":
            self.render()
        terms = torch.zeros(self.num_envs, len(self.task.reward.term_names))
        return now.observation.numpy().copy(), _infos(self.task, now, terms, wanted)

    def step(self, actions: np.ndarray) -> Step:
        """Drives every car one time step: actions [N] to observations, rewards, terminated, truncated and infos.

        Raises:
            ActionError: these are not N actions; it is a ConfigError and Gymnasium's InvalidAction.
            ResetNeeded: there was no reset, or with `autoreset_mode` "Disabled" none for a car whose episode ended.
        """
        if self._now is None:
            raise ResetNeeded("call reset before the first step")
        taken = many_actions(actions, self.num_envs, self.task.action)
        before, resetting = self._now, self._ended
        if resetting.any():
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise ResetNeeded(f"car {resetting.argmax()} has ended its episode; reset it with a reset_mask")
            before = self._put(before, resetting)  # A car in a wall could not be driven on.
        after = self.task.step(before.state, taken)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            outcome = self._end_in_same_step(after)
        else:
            outcome = self._end_in_next_step(before, after, resetting)
        if self.render_mode == "human":
            self.render()
        return outcome

    def render(self) -> tuple[np.ndarray] | None:
        """One picture of the cars on the first track.

        Raises:
            ConfigError: there is no render mode, or for a window no display or no pygame.
        """
        if self.render_mode is None:
            raise ConfigError(f"there is no render_mode; choose one of {', '.join(RENDER_MODES)} to see something")
        if self._now is None:
            raise ResetNeeded("call reset before the first picture")
        self._picture = self._picture or _make_fleet_picture(self.task)
        shown = self._now.state.cars.track.numpy() == 0
        cars = f"{shown.sum():,} of {self.num_envs:,} cars" if not shown.all() else f"{self.num_envs:,} cars"
        title = f"{self.tracks[0].name}: {cars}"
        picture = self._picture.draw(self._now.state.cars.pose.double().numpy()[shown], self._ended[shown], title)
        if self.render_mode == "rgb_array":
            return (picture,)
        from carrl.render.window import Window

        self._window = self._window or Window((picture.shape[1], picture.shape[0]), "CarRL")
        self._window.show(picture, self.metadata["render_fps"])
        return None

    def close_extras(self, **_: Any) -> None:
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()
        self._window = None

    def _end_in_next_step(self, before: EpisodeStart, after: StepResult, resetting: Bools) -> Step:
        """What the step brought, but for the cars that it was to put back to the start, where they were before it."""
        now, terms, terminated = EpisodeStart(after.state, after.observation), after.reward_terms, after.terminated
        truncated = self._is_last_step(now)
        if resetting.any():
            keep, reset = torch.from_numpy(~resetting), torch.from_numpy(resetting)
            now = now.replacing(reset, before[reset])
            terms, terminated, truncated = terms * keep[:, None], terminated & keep, truncated & keep
        self._now = now
        ends = terminated.numpy(), truncated.numpy()
        self._ended = ends[0] | ends[1]
        return now.observation.numpy().copy(), _rewards(terms), *ends, _infos(self.task, now, terms)

    def _end_in_same_step(self, after: StepResult) -> Step:
        """What the step brought; cars whose episode ended are at the start again, their end is in the infos."""
        now, terms, terminated = EpisodeStart(after.state, after.observation), after.reward_terms, after.terminated
        ends = terminated.numpy(), self._is_last_step(now).numpy()
        ended = ends[0] | ends[1]
        rewards, finals = _rewards(terms), {}
        if ended.any():
            finals = _finals(self.task, now, terms, ended)
            now, terms = self._put(now, ended), terms * torch.from_numpy(~ended)[:, None]
        self._now = now
        return now.observation.numpy().copy(), rewards, *ends, _infos(self.task, now, terms) | finals

    def _is_last_step(self, now: EpisodeStart) -> Tensor:
        """Whether the time limit is reached, [N], bool."""
        return now.state.step >= self.task.max_steps

    def _put(self, now: EpisodeStart | None, wanted: Bools) -> EpisodeStart:
        """The wanted cars [N] at the start of new episodes."""
        cars, first = torch.from_numpy(wanted), self._first_start
        start = first[cars] if first else self.task.start(cars)
        return start if now is None or wanted.all() else now.replacing(cars, start)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [seed_number(seed) + car for car in range(self.num_envs)]
        seeds = seed_list(seed)
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


def _infos(task: Task, now: EpisodeStart, terms: Tensor, cars: Bools | None = None) -> dict[str, Any]:
    """Gymnasium's form of infos: beside each of the values [N, ...] which cars [N] have it, by default all.

    They are where the cars are, how far they came, and the reward's terms [N, K]; zero for the other cars.
    """
    cars_now = now.state.cars
    place = {name: getattr(cars_now, name).numpy().copy() for name in ("pose", "gates_passed", "track")}
    infos: dict[str, Any] = {}
    for name, value in (place | _by_name(task, terms)).items():
        if cars is not None:
            value[~cars] = 0
        infos[name] = value
        infos[f"_{name}"] = np.ones(len(value), dtype=bool) if cars is None else cars.copy()
    return infos


def _finals(task: Task, now: EpisodeStart, terms: Tensor, ended: Bools) -> dict[str, Any]:
    """The last views and infos of the cars whose episode ended, in Gymnasium's form."""
    views = np.full(len(ended), None, dtype=object)
    for car in ended.nonzero()[0]:
        views[car] = now.observation[car].numpy().copy()
    last_info = _infos(task, now, terms, ended)
    return {"final_obs": views, "_final_obs": ended.copy(), "final_info": last_info, "_final_info": ended.copy()}


def _make_fleet_picture(task: Task) -> "FleetPicture":
    from carrl.render.live import FleetPicture

    return FleetPicture(task.simulator.track, task.simulator.vehicle.body.half_width)
