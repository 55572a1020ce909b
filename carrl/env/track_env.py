"""The driving task as a TorchRL environment.

Shapes: `N` cars driven side by side, `R` rays.
"""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from carrl.env.observation import FIRST_ACTION, observation_size, observe
from carrl.env.reward import TERMS, Reward
from carrl.errors import ConfigError
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator, State
from carrl.sim.track import Track
from carrl.sim.vehicle import Action, Vehicle


class TrackEnv(EnvBase):
    """Cars that learn to drive round a track from their distance sensors alone.

    | key | shape, type | meaning |
    |---|---|---|
    | `observation` | [N, R] float32 | distance along each ray / range, 0..1, right to left; see `observe_action` |
    | `action` | [N] int64 | 0 forward, 1 left, 2 right |
    | `reward` | [N, 1] float32 | sum of `reward_terms` |
    | `reward_terms` | [N, 4] float32 | collision, proximity, gate, steering; zero after a reset |
    | `terminated` | [N, 1] bool | the car touched a wall |
    | `truncated` | [N, 1] bool | the episode reached `max_steps` without a collision |
    | `pose` | [N, 3] float32 | x m, y m, heading rad counter-clockwise from +x |
    | `next_gate`, `gates_passed`, `step` | [N] int64 | the gate that counts next; gates and steps of the episode |
    | `last_action` | [N] int64 | of the step before; forward after a reset |

    The state of the cars travels in the TensorDict; the environment keeps only its random generators, which drive
    random starts and `rand_action`. The same seed gives the same rollout, whatever other code draws from torch.

    Args:
        track: a track, or what `Track.load` takes.
        num_envs: how many cars, N; so many for each seed, if there are several.
        device: where the tensors live.
        seed: of the environment's generator; None for a fresh one. Several seeds put several environments into one, one
            after the other, each of whose cars drive as they would alone.
        vehicle: the car.
        sensor: its rays.
        reward: what a step earns.
        max_steps: length at which an episode is truncated, steps.
        random_start: start anywhere along the centreline instead of on the start line.
        observe_action: append the last action to the observation, one-hot: [N, R + 3].

    Raises:
        TrackError: the track cannot be loaded.
        ConfigError: a parameter is out of its range.
    """

    def __init__(
        self,
        track: Track | str = "paper",
        num_envs: int = 1,
        device: torch.device | str = "cpu",
        seed: int | Sequence[int] | None = None,
        *,
        vehicle: Vehicle | None = None,
        sensor: Sensor | None = None,
        reward: Reward | None = None,
        max_steps: int = 1000,
        random_start: bool = False,
        observe_action: bool = False,
    ) -> None:
        """Builds the simulator and declares the specs."""
        if num_envs < 1:
            raise ConfigError(f"env.num_envs is {num_envs}; it must be at least 1")
        if max_steps < 1:
            raise ConfigError(f"env.max_steps is {max_steps}; it must be at least 1")
        seeds = [seed] if seed is None or isinstance(seed, int) else list(seed)
        if not seeds:
            raise ConfigError("seed names no seed; give a whole number, or a list of them")
        super().__init__(device=device, batch_size=[num_envs * len(seeds)])
        self.max_steps = max_steps
        self.random_start = random_start
        self.observe_action = observe_action
        self.reward = reward or Reward()
        track = track if isinstance(track, Track) else Track.load(track)
        self.simulator = Simulator(track, vehicle or Vehicle(), sensor or Sensor(), self.device)
        self._generators = [_generator(each) for each in seeds]
        self._share = num_envs
        self._declare_specs()
        self._start_line = self._start(torch.zeros(self.batch_size, dtype=torch.float64))

    @property
    def track(self) -> Track:
        """The track that all cars drive on."""
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
        drawn = [torch.randint(len(Action), (self._share,), generator=each) for each in self._generators]
        action = torch.cat(drawn).to(self.device)
        if tensordict is None:
            return TensorDict({"action": action}, batch_size=self.batch_size, device=self.device)
        return tensordict.set("action", action)

    def _reset(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        """All cars at the start; in a partial reset EnvBase keeps the others as they were."""
        if not self.random_start:
            return self._start_line.clone()
        wanted = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            wanted = tensordict["_reset"].view(-1).cpu()
        return self._start(self._draw_stations(wanted))

    def _draw_stations(self, wanted: Tensor) -> Tensor:
        """Places along the track, [N]; a generator is only drawn from if one of its own cars is `wanted`, [N]."""
        stations = torch.zeros(self.batch_size, dtype=torch.float64)
        for each, share, cars in zip(
            self._generators, stations.split(self._share), wanted.split(self._share), strict=True
        ):
            if cars.any():
                share.copy_(torch.rand(self._share, dtype=torch.float64, generator=each))
        return stations * self.track.length

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        before = State(tensordict["pose"], tensordict["next_gate"], tensordict["gates_passed"])
        outcome = self.simulator.step(before, tensordict["action"])
        action = tensordict["action"]
        readings = outcome.ranges / self.sensor_range
        reward_terms = self.reward.terms(
            readings, outcome.collided, outcome.gates_passed, action, tensordict["last_action"]
        )
        step = tensordict["step"] + 1
        truncated = (step >= self.max_steps) & ~outcome.collided
        after = self._pack(outcome.state, readings, reward_terms, step, action)
        return after.update(
            {
                "reward": reward_terms.sum(dim=-1, keepdim=True),
                "terminated": outcome.collided[:, None],
                "truncated": truncated[:, None],
                "done": (outcome.collided | truncated)[:, None],
            }
        )

    def _set_seed(self, seed: int | None) -> None:
        for offset, generator in enumerate(self._generators):
            generator.manual_seed((0 if seed is None else seed) + offset)

    def _start(self, stations: Tensor) -> TensorDict:
        """The cars at the start of an episode, not done: stations [N], m."""
        state = self.simulator.start(stations)
        readings = self.simulator.sense(state.pose) / self.sensor_range
        terms = readings.new_zeros(*self.batch_size, len(TERMS))
        first_action = torch.full_like(state.next_gate, FIRST_ACTION)
        not_done = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        return self._pack(state, readings, terms, torch.zeros_like(state.next_gate), first_action).update(
            {"done": not_done, "terminated": not_done.clone(), "truncated": not_done.clone()}
        )

    def _pack(
        self, state: State, readings: Tensor, reward_terms: Tensor, step: Tensor, last_action: Tensor
    ) -> TensorDict:
        values = {
            "observation": observe(readings, last_action, self.observe_action),
            "reward_terms": reward_terms,
            "step": step,
            "last_action": last_action.clone(),
            **state._asdict(),
        }
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _declare_specs(self) -> None:
        cars = self.batch_size[0]
        options = {"device": self.device}
        count = Unbounded((cars,), dtype=torch.int64, **options)
        state = {
            "pose": Unbounded((cars, 3), dtype=torch.float32, **options),
            "next_gate": Categorical(self.track.gate_count, shape=(cars,), dtype=torch.int64, **options),
            "gates_passed": count,
            "step": count.clone(),
            "last_action": Categorical(len(Action), shape=(cars,), dtype=torch.int64, **options),
        }
        size = observation_size(self.simulator.sensor.rays, self.observe_action)
        self.observation_spec = Composite(
            observation=Bounded(0.0, 1.0, shape=(cars, size), dtype=torch.float32, **options),
            reward_terms=Unbounded((cars, len(TERMS)), dtype=torch.float32, **options),
            **state,
            shape=(cars,),
            **options,
        )
        self.state_spec = Composite({key: spec.clone() for key, spec in state.items()}, shape=(cars,), **options)
        self.action_spec = Categorical(len(Action), shape=(cars,), dtype=torch.int64, **options)
        self.reward_spec = Unbounded((cars, 1), dtype=torch.float32, **options)
        flag = Binary(1, shape=(cars, 1), dtype=torch.bool, **options)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(cars,), **options)


def _generator(seed: int | None) -> torch.Generator:
    generator = torch.Generator()
    if seed is None:
        generator.seed()
        return generator
    return generator.manual_seed(seed)
