"""The driving task as a TorchRL environment.

Shapes: `N` cars driven side by side, `R` rays.
"""

import contextlib
import inspect
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from carrl.errors import ConfigError, shown
from carrl.sim.others import Others
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.traffic import Opponents
from carrl.sim.vehicle import POSE, VehicleModel
from carrl.task.action import ActionMap, in_words
from carrl.task.checks import seed_list, seed_number
from carrl.task.end import End
from carrl.task.episode import EpisodeState, Start
from carrl.task.observation import Observation
from carrl.task.reward import Reward
from carrl.task.task import EpisodeStart, StepResult, Tracks, make_task
from carrl.tracks.track import Track


class TrackEnv(EnvBase):
    """Cars that learn to drive round a track from their distance sensors alone.

    | key | shape, type | meaning |
    |---|---|---|
    | `observation` | [N, O] float32 | by default distance along each ray / range, 0..1, right to left |
    | `action` | [N] int64 | by default 0 forward, 1 left, 2 right |
    | `reward` | [N, 1] float32 | sum of `reward_terms` |
    | `reward_terms` | [N, K] float32 | by default collision, proximity, gate, steering; zero after a reset |
    | `terminated` | [N, 1] bool | the car touched a wall, or what else `end` says |
    | `truncated` | [N, 1] bool | the episode reached `max_steps` without that |
    | `pose` | [N, 3] float32 | x m, y m, heading rad counter-clockwise from +x |
    | `state` | [N, S] float32 | named by `state_names`, the pose first; of vehicles whose state has more than a pose |
    | `next_gate`, `gates_passed`, `step` | [N] int64 | the gate that counts next; gates and steps of the episode |
    | `last_action` | as `action` | of the step before; the first action after a reset |
    | `track` | [N] int64 | index into `tracks` of what the car drives on |
    | `station` | [N] float32 | way along the centreline from the start line, m; if a term asks where the car is |
    | `stalled` | [N] int64 | steps in a row without progress; if they end an episode |
    | `collided` | [N, 1] bool | touching a wall ended the episode; if something else may end one, too |
    | `other_poses` | [N, 3 * M] float32 | of the opponents in its world: x m, y m, heading rad; if there are any |
    | `others` | [N] | state, station, gates ... of the opponents in each car's world, [N, M, ...]; if there are any |

    An action is a whole number of any integer type, and each car has one. A car whose episode has ended is to be reset,
    as TorchRL's collectors, `rollout` and `step_and_maybe_reset` do; as elsewhere in TorchRL `step` does not look at
    that. A car that is handed in with a pose that is not finite terminates.

    The state of the cars travels in the TensorDict; the environment keeps only its random generators, which drive
    random starts, sensor noise and `rand_action`. The same seed gives the same rollout, whatever other code draws from
    torch.

    Args:
        track: a track, or what `Track.load` takes; or a list of such, of which car i drives on number i modulo their
            number.
        num_envs: how many cars, N; so many for each seed, if there are several.
        device: where the tensors live.
        seed: of the environment's generator; None for a fresh one. Several seeds put several environments into one, one
            after the other, each of whose cars drive as they would alone.
        vehicle: the car.
        sensor: its rays, and how far they err.
        action: what an agent chooses among.
        observation: what it is told.
        reward: what a step earns; it counts true distances, whatever the sensor reads.
        start: where episodes start.
        end: what ends them before their time; by default touching a wall or another car.
        cars_per_world: how many cars share a world, and see and touch each other; so many consecutive ones of the N, or
            where there are opponents each one of the N and its opponents. A car whose episode ended starts anew where
            there is room among the others; with opponents its whole world does.
        opponents: what drives the other cars of each world; None if all cars are among the N.
        max_steps: length at which an episode is truncated, steps.

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter, a seed or an action is of another type or out of its range.
    """

    def __init_subclass__(cls, **keywords: Any) -> None:
        """Shows what the subclass takes, too."""
        super().__init_subclass__(**keywords)
        _show_signature(cls)

    def __init__(
        self,
        track: Tracks = "paper",
        num_envs: int = 1,
        device: torch.device | str = "cpu",
        seed: int | Sequence[int] | None = None,
        *,
        vehicle: VehicleModel | None = None,
        sensor: Sensor | None = None,
        action: ActionMap | None = None,
        observation: Observation | None = None,
        reward: Reward | None = None,
        start: Start | None = None,
        end: End | None = None,
        cars_per_world: int = 1,
        opponents: Opponents | None = None,
        max_steps: int = 1000,
    ) -> None:
        """Builds the simulator and declares the specs."""
        seeds = seed_list(seed)
        if not seeds:
            raise ConfigError("seed names no seed; give a whole number, or a list of them")
        task = make_task(
            track,
            num_envs,
            seeds,
            device,
            vehicle=vehicle,
            sensor=sensor,
            action=action,
            observation=observation,
            reward=reward,
            start=start,
            end=end,
            cars_per_world=cars_per_world,
            opponents=opponents,
            max_steps=max_steps,
        )
        super().__init__(device=device, batch_size=[task.cars])
        self.task = task
        self._cars_before_reset: CarState | None = None
        self._state_key = "pose" if self.state_names == POSE else "state"
        self._declare_specs()
        self._start_line = self._begin(task.start()) if task.starts_alike else None

    @property
    def simulator(self) -> Simulator:
        """What moves the cars."""
        return self.task.simulator

    def __repr__(self) -> str:
        """One line: what is driven on, by how many cars, with how many rays, and where."""
        names = [track.name for track in self.tracks]
        track, cars = shown(names[0] if len(names) == 1 else names), self.batch_size[0]
        rays, device = self.simulator.sensor.rays, self.simulator.device
        return f"TrackEnv({track}, cars={cars}, rays={rays}, max_steps={self.task.max_steps}, device={str(device)!r})"

    @property
    def tracks(self) -> tuple[Track, ...]:
        """What the key `track` counts: the tracks given, each with its variants if there are any."""
        return self.simulator.tracks

    @property
    def track(self) -> Track:
        """The first track: the only one, if there is one."""
        return self.simulator.track

    @property
    def sensor_range(self) -> float:
        """Distance at which a ray reads 1, m."""
        return self.simulator.sensor.max_range

    @property
    def sensor_angles(self) -> Tensor:
        """Directions of the rays, [R], float32, rad counter-clockwise from the heading."""
        return self.simulator.sensor_angles

    @property
    def state_names(self) -> tuple[str, ...]:
        """Of the entries of `state`, which begin with x, y, heading."""
        return self.simulator.vehicle.state_names

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Draws an action for every car from the environment's own generators."""
        action = self.task.random_action()
        if tensordict is None:
            return TensorDict({"action": action}, batch_size=self.batch_size, device=self.device)
        return tensordict.set("action", action)

    def reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        """Puts cars at a start; see EnvBase. Those that start among others are told of them.

        TorchRL 0.14's `step_and_maybe_reset` hands `_reset` nothing but the mask.
        """
        if not self.task.shares_worlds or tensordict is None or "_reset" not in tensordict:
            return super().reset(tensordict, **options)
        with self.among(tensordict):
            return super().reset(tensordict, **options)

    @contextlib.contextmanager
    def among(self, tensordict: TensorDictBase) -> Iterator[None]:
        """Lets cars that start meanwhile find their place among these cars, [N]."""
        self._cars_before_reset = self._cars(tensordict)
        try:
            yield
        finally:
            self._cars_before_reset = None

    def _step_and_maybe_reset(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        """A step, and a new start for those cars whose episode it has ended; see EnvBase.

        It returns what TorchRL 0.14's own does (a test compares them), without going through all specs each time.
        """
        if tensordict.device != self.device:
            tensordict = tensordict.to(self.device)
        after = self._step(tensordict)
        values = {key: value for key, value in tensordict.items() if key != "next"}
        values |= {key: value for key, value in after.copy().items() if key != "reward"}
        following = TensorDict(values, batch_size=self.batch_size, device=self.device)
        done = after["done"]
        if done.any():
            ended = TensorDict({"_reset": done}, batch_size=self.batch_size, device=self.device)
            with self.among(following) if self.task.shares_worlds else contextlib.nullcontext():
                begun = self._reset(ended)
            for key, value in begun.items(True, True):
                wanted = done.view(-1, *[1] * (value.dim() - 1))
                following[key] = torch.where(wanted, value, following[key])
        return tensordict.set("next", after), following

    def _reset(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        """All cars at the start, of which EnvBase takes those that `_reset` names."""
        if self._start_line is not None:
            return self._start_line.clone()
        if tensordict is None or "_reset" not in tensordict:
            return self._begin(self.task.start())
        wanted = tensordict["_reset"].view(-1)
        return self._begin(self.task.start(wanted, self._cars_before_reset), wanted)

    def _cars(self, tensordict: TensorDictBase) -> CarState:
        """Where the cars are, with their stations if those are kept."""
        cars = CarState(*(tensordict[key] for key in (self._state_key, "next_gate", "gates_passed", "track")))
        return replace(cars, station=tensordict["station"]) if "station" in self.task.carried else cars

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        cars = CarState(*(tensordict[key] for key in (self._state_key, "next_gate", "gates_passed", "track")))
        if self.task.has_opponents:
            others = tensordict["others"]
            cars.others = Others(*(others.get(field.name, None) for field in fields(Others)))
        state = EpisodeState(cars, tensordict["step"], tensordict["last_action"])
        if self.task.carried:
            state = self._carrying(state, tensordict)
        action = tensordict["action"]
        if action.dtype is not state.last_action.dtype or action.shape != state.last_action.shape:
            action = self._of_spec(action, state.last_action)
        try:
            after = self.task.step(state, action)
        except (ValueError, IndexError) as error:  # The compiled code looks at each car's numbers as it goes.
            raise self._refusal(action, error) from error
        values = self._as_dict(after) | {
            "reward_terms": after.reward_terms,
            "reward": after.reward_terms.sum(dim=-1, keepdim=True),
            "terminated": after.terminated[:, None],
            "truncated": after.truncated[:, None],
            "done": (after.terminated | after.truncated)[:, None],
        }
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _carrying(self, state: EpisodeState, tensordict: TensorDictBase) -> EpisodeState:
        """The state with what some terms need from step to step."""
        station, stalled, seen = (
            tensordict[key] if name in self.task.carried else None
            for name, key in (("station", "station"), ("stalled", "stalled"), ("seen", "observation"))
        )
        return replace(state, cars=replace(state.cars, station=station), stalled=stalled, seen=seen)

    def _set_seed(self, seed: int | None) -> None:
        self.task.streams.seed(0 if seed is None else seed_number(seed))

    def _of_spec(self, action: Tensor, last: Tensor) -> Tensor:
        """Actions of another integer type, or of another floating one, in the type of the last actions.

        Raises:
            ConfigError: they are of another kind, or not one for each car.
        """
        if action.dtype is torch.bool or action.is_floating_point() is not last.is_floating_point():
            raise ConfigError(f"action is of {action.dtype}; it must be of {last.dtype}: {in_words(self.task.action)}")
        if action.shape != last.shape:
            raise ConfigError(f"action has the shape {list(action.shape)}; it must have {list(last.shape)}")
        return action.to(last.dtype)

    def _refusal(self, action: Tensor, error: Exception) -> ConfigError:
        """Says which car's number it was that the simulator could not use."""
        names = self.task.action.names
        wrong = ((action < 0) | (action >= len(names))).nonzero() if names else action[:0]
        if len(wrong):
            car = int(wrong[0])
            return ConfigError(f"action of car {car} is {int(action[car])}; it must be {in_words(self.task.action)}")
        return ConfigError(f"{error}; the state is none that this environment returned, so reset the cars")

    def _begin(self, begun: EpisodeStart, wanted: Tensor | None = None) -> TensorDict:
        """All cars, or those `wanted`, [N] bool, at the start of an episode, not done; others at anyone's start."""
        values = self._as_dict(begun)
        if wanted is not None and len(begun.observation) < len(wanted):
            start_of = (wanted.cumsum(0) - 1).clamp_(min=0)
            values = {key: value.index_select(0, start_of) for key, value in values.items()}
        values["reward_terms"] = values["observation"].new_zeros(*self.batch_size, len(self.task.reward.term_names))
        for key in ("done", "terminated", "truncated"):
            values[key] = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _as_dict(self, now: EpisodeStart | StepResult) -> dict[str | tuple[str, str], Tensor]:
        """The state and the observation by the names of the keys."""
        state, cars = now.state, now.state.cars
        carried = {"station": cars.station, "stalled": state.stalled, "collided": self.task.collided(state)}
        others: dict[str, Tensor] = vars(cars.others) if self.task.has_opponents else {}
        if self.task.has_opponents and cars.others is not None:
            carried["other_poses"] = cars.others.state[..., :3].flatten(1)
        found: dict[str | tuple[str, str], Tensor] = {
            ("others", name): value for name, value in others.items() if value is not None
        }
        found |= {name: value for name, value in carried.items() if value is not None}
        return found | {
            "observation": now.observation,
            "pose": cars.pose if self._state_key == "state" else cars.state,
            self._state_key: cars.state,
            "next_gate": cars.next_gate,
            "gates_passed": cars.gates_passed,
            "track": cars.track,
            "step": state.step,
            "last_action": state.last_action,
        }

    def _declare_specs(self) -> None:
        cars, task = self.batch_size[0], self.task

        def numbers(width: int) -> Unbounded:
            return Unbounded((cars, width), dtype=torch.float32)

        def index(high: int) -> Categorical:
            return Categorical(high, shape=(cars,), dtype=torch.int64)

        count, flag = Unbounded((cars,), dtype=torch.int64), Binary(1, shape=(cars, 1), dtype=torch.bool)
        self.action_spec = task.action.spec.expand(cars, *task.action.spec.shape)
        state = {
            self._state_key: numbers(len(self.state_names)),
            "next_gate": index(max(track.gate_count for track in self.tracks)),
            "gates_passed": count,
            "track": index(len(self.tracks)),
            "step": count.clone(),
            "last_action": task.action.spec.expand(cars, *task.action.spec.shape),
        }
        if "station" in task.carried:
            state["station"] = Unbounded((cars,), dtype=torch.float32)
        if "stalled" in task.carried:
            state["stalled"] = count.clone()
        if task.has_opponents:
            state["others"] = self._others_spec(task.simulator.cars_per_world - 1)
        low, high = task.observation_bounds
        self.observation_spec = Composite(
            observation=Bounded(low.expand(cars, -1), high.expand(cars, -1), dtype=torch.float32),
            reward_terms=numbers(len(task.reward.term_names)),
            **{"pose": numbers(3), **state},
            **({"collided": flag.clone()} if task.may_end_otherwise else {}),
            **({"other_poses": numbers(3 * (task.simulator.cars_per_world - 1))} if task.has_opponents else {}),
            shape=(cars,),
        ).to(self.device)
        self.state_spec = Composite({key: spec.clone() for key, spec in state.items()}, shape=(cars,)).to(self.device)
        self.reward_spec = Unbounded((cars, 1), dtype=torch.float32).to(self.device)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(cars,)).to(
            self.device
        )

    def _others_spec(self, others: int) -> Composite:
        """Of the opponents of each car's world, so many."""
        cars = self.batch_size[0]
        shape, size, memory = (cars, others), len(self.state_names), self.simulator.memory_size
        number, count = Unbounded(shape, dtype=torch.float32), Unbounded(shape, dtype=torch.int64)
        return Composite(
            state=Unbounded((*shape, size), dtype=torch.float32),
            next_gate=count,
            gates_passed=count.clone(),
            **{name: number.clone() for name in ("station", "lane", "pace")},
            **({"memory": Unbounded((*shape, memory), dtype=torch.float32)} if memory else {}),
            shape=(cars,),
        )


def _show_signature(env_class: type) -> None:
    """Lets `inspect.signature`, and what shows it while one types, see what a class takes.

    torchrl 0.14's metaclass makes all environments with a function of its own, `(*args, **kwargs)`.
    """
    signature = inspect.signature(env_class.__init__)  # type: ignore[misc]
    _, *parameters = signature.parameters.values()
    env_class.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]


_show_signature(TrackEnv)
