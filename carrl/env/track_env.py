"""The driving task as a TorchRL environment.

Shapes: `N` cars driven side by side, `R` rays.
"""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from carrl.env.checks import seed_list, seed_number
from carrl.env.reward import Reward
from carrl.env.task import Situation, Task, Tracks
from carrl.errors import ConfigError, shown
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator, State
from carrl.sim.track import Track
from carrl.sim.vehicle import Action, VehicleModel


class TrackEnv(EnvBase):
    """Cars that learn to drive round a track from their distance sensors alone.

    | key | shape, type | meaning |
    |---|---|---|
    | `observation` | [N, R] float32 | distance along each ray / range, 0..1, right to left; see `observe_action` |
    | `action` | [N] int64 | 0 forward, 1 left, 2 right |
    | `reward` | [N, 1] float32 | sum of `reward_terms` |
    | `reward_terms` | [N, 4] float32 | collision, proximity, gate, steering, shaping if any; zero after a reset |
    | `terminated` | [N, 1] bool | the car touched a wall |
    | `truncated` | [N, 1] bool | the episode reached `max_steps` without a collision |
    | `pose` | [N, 3] float32 | x m, y m, heading rad counter-clockwise from +x |
    | `next_gate`, `gates_passed`, `step` | [N] int64 | the gate that counts next; gates and steps of the episode |
    | `last_action` | [N] int64 | of the step before; forward after a reset |
    | `track` | [N] int64 | index into `tracks` of what the car drives on |

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
        reward: what a step earns; it counts true distances, whatever the sensor reads.
        max_steps: length at which an episode is truncated, steps.
        random_start: start anywhere along the centreline instead of on the start line.
        start_offset: how far beside the centreline an episode may start, as a share of the room there, 0..1.
        heading_jitter: how far an episode's first heading may deviate from the driving direction, degrees.
        sample_track: draw each car's track anew for each episode.
        mirrored: drive every other episode, by chance, on the mirror image of the track.
        reversed: drive every other episode, by chance, the other way round.
        observe_action: append the last action to the observation, one-hot: [N, R + 3].

    Raises:
        TrackError: a track cannot be loaded.
        ConfigError: a parameter, a seed or an action is of another type or out of its range.
    """

    def __init__(
        self,
        track: Tracks = "paper",
        num_envs: int = 1,
        device: torch.device | str = "cpu",
        seed: int | Sequence[int] | None = None,
        *,
        vehicle: VehicleModel | None = None,
        sensor: Sensor | None = None,
        reward: Reward | None = None,
        max_steps: int = 1000,
        random_start: bool = False,
        start_offset: float = 0.0,
        heading_jitter: float = 0.0,
        sample_track: bool = False,
        mirrored: bool = False,
        reversed: bool = False,
        observe_action: bool = False,
    ) -> None:
        """Builds the simulator and declares the specs."""
        seeds = seed_list(seed)
        if not seeds:
            raise ConfigError("seed names no seed; give a whole number, or a list of them")
        task = Task(
            track,
            num_envs,
            seeds,
            device,
            vehicle=vehicle,
            sensor=sensor,
            reward=reward,
            max_steps=max_steps,
            random_start=random_start,
            start_offset=start_offset,
            heading_jitter=heading_jitter,
            sample_track=sample_track,
            mirrored=mirrored,
            reversed=reversed,
            observe_action=observe_action,
        )
        super().__init__(device=device, batch_size=[task.cars])
        self.task = task
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

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Draws an action for every car from the environment's own generators."""
        action = self.task.streams.integers(len(Action)).to(self.device)
        if tensordict is None:
            return TensorDict({"action": action}, batch_size=self.batch_size, device=self.device)
        return tensordict.set("action", action)

    def _reset(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        """All cars at the start, of which EnvBase takes those that `_reset` names."""
        if self._start_line is not None:
            return self._start_line.clone()
        if tensordict is None or "_reset" not in tensordict:
            return self._begin(self.task.start())
        wanted = tensordict["_reset"].view(-1)
        return self._begin(self.task.start(wanted), wanted.nonzero()[:, 0])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state = State(*(tensordict[key] for key in State._fields))
        before = Situation(state, *(tensordict[key] for key in Situation._fields[1:]))
        action = tensordict["action"]
        if action.dtype is not torch.int64 or action.shape != self.batch_size:
            action = self._whole_numbers(action)
        try:
            after = self.task.step(before, action)
        except ValueError as error:  # The compiled code looks at each car's numbers as it goes.
            raise _refusal(action, error) from error
        values = _as_dict(after.situation) | {
            "reward_terms": after.reward_terms,
            "reward": after.reward_terms.sum(dim=-1, keepdim=True),
            "terminated": after.terminated[:, None],
            "truncated": after.truncated[:, None],
            "done": (after.terminated | after.truncated)[:, None],
        }
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self.task.streams.seed(0 if seed is None else seed_number(seed))

    def _whole_numbers(self, action: Tensor) -> Tensor:
        """Actions of another integer type as int64.

        Raises:
            ConfigError: they are no integers, or not one for each car.
        """
        if action.dtype is torch.bool or action.is_floating_point() or action.is_complex():
            raise ConfigError(f"action is of {action.dtype}; it must be of torch.int64: 0 forward, 1 left or 2 right")
        if action.shape != self.batch_size:
            raise ConfigError(f"action has the shape {list(action.shape)}; it must have {list(self.batch_size)}")
        return action.long()

    def _begin(self, situation: Situation, cars: Tensor | None = None) -> TensorDict:
        """All cars, or these [K], at the start of an episode, not done; zeros elsewhere."""
        values = _as_dict(situation)
        if cars is not None:
            for key, value in values.items():
                values[key] = value.new_zeros(*self.batch_size, *value.shape[1:]).index_copy_(0, cars, value)
        values["reward_terms"] = values["observation"].new_zeros(*self.batch_size, len(self.task.reward.term_names))
        for key in ("done", "terminated", "truncated"):
            values[key] = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _declare_specs(self) -> None:
        cars = self.batch_size[0]
        options = {"device": self.device}
        count = Unbounded((cars,), dtype=torch.int64, **options)

        def index(high: int) -> Categorical:
            return Categorical(high, shape=(cars,), dtype=torch.int64, **options)

        state = {
            "pose": Unbounded((cars, 3), dtype=torch.float32, **options),
            "next_gate": index(max(track.gate_count for track in self.tracks)),
            "gates_passed": count,
            "track": index(len(self.tracks)),
            "step": count.clone(),
            "last_action": index(len(Action)),
        }
        size = self.task.observation_size
        self.observation_spec = Composite(
            observation=Bounded(0.0, 1.0, shape=(cars, size), dtype=torch.float32, **options),
            reward_terms=Unbounded((cars, len(self.task.reward.term_names)), dtype=torch.float32, **options),
            **state,
            shape=(cars,),
            **options,
        )
        self.state_spec = Composite({key: spec.clone() for key, spec in state.items()}, shape=(cars,), **options)
        self.action_spec = index(len(Action))
        self.reward_spec = Unbounded((cars, 1), dtype=torch.float32, **options)
        flag = Binary(1, shape=(cars, 1), dtype=torch.bool, **options)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(cars,), **options)


def _refusal(action: Tensor, error: ValueError) -> ConfigError:
    """Says which car's number it was that the compiled code could not use."""
    wrong = (action < 0) | (action >= len(Action))
    if wrong.any():
        car = int(wrong.nonzero()[0])
        return ConfigError(f"action of car {car} is {int(action[car])}; it must be 0 forward, 1 left or 2 right")
    return ConfigError(f"{error}; the state is none that this environment returned, so reset the cars")


def _as_dict(situation: Situation) -> dict[str, Tensor]:
    """By the names of the keys."""
    state, *others = situation
    return state._asdict() | dict(zip(Situation._fields[1:], others, strict=True))
