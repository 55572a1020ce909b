"""The driving task as TorchRL's multi-agent algorithms see it: worlds whose cars are one group of agents.

Shapes: `W` worlds, `K` cars of each, `N` = W * K.
"""

from typing import Any

from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase

from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError

GROUP = "cars"


class GroupTrackEnv(EnvBase):
    """`TrackEnv` with the cars of a world side by side: keys such as `("cars", "observation")`, [W, K, ...].

    All keys of `TrackEnv` are in the group `cars`, those that say when an episode is done, too: each car's episodes
    begin and end on their own.

    Args:
        env: whose cars share worlds, and of which there are no opponents.

    Attributes:
        env: the same, with the cars in a row.
        group_map: the one group, and what its agents are called.

    Raises:
        ConfigError: each of the cars is in a world of its own.
    """

    def __init__(self, env: TrackEnv) -> None:
        """Declares the specs."""
        if not env.task.shares_worlds:
            raise ConfigError("the cars of this environment do not share worlds; set cars_per_world, and no opponents")
        self._cars = env.simulator.cars_per_world
        worlds = env.batch_size[0] // self._cars
        super().__init__(device=env.device, batch_size=[worlds])
        self.env = env
        self.group_map = {GROUP: [f"car_{number}" for number in range(self._cars)]}
        self.action_spec = self._grouped(env.full_action_spec)
        self.observation_spec, self.state_spec = self._grouped(env.observation_spec), self._grouped(env.state_spec)
        self.reward_spec, self.done_spec = self._grouped(env.full_reward_spec), self._grouped(env.full_done_spec)

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Draws an action for every car from the environment's own generators."""
        tensordict = TensorDict({}, batch_size=self.batch_size) if tensordict is None else tensordict
        return tensordict.set((GROUP, "action"), self._side_by_side(self.env.task.random_action()))

    def _side_by_side(self, values: Tensor) -> Tensor:
        return values.unflatten(0, (-1, self._cars))

    def _grouped(self, spec: Composite) -> Composite:
        shape = (self.batch_size[0], self._cars)
        return Composite({GROUP: spec.unflatten(0, shape)}, shape=self.batch_size)

    def _in_group(self, flat: TensorDictBase) -> TensorDict:
        side_by_side = flat.reshape(*self.batch_size, self._cars)
        return TensorDict({GROUP: side_by_side}, batch_size=self.batch_size, device=self.device)

    def reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        """Puts cars at a start, all or those whose key `("cars", "_reset")` says so; see EnvBase."""
        if tensordict is None or (GROUP, "_reset") not in tensordict.keys(include_nested=True):
            return super().reset(tensordict, **options)
        with self.env.among(tensordict[GROUP].flatten(0, 1)):
            return super().reset(tensordict, **options)

    def _reset(self, tensordict: TensorDictBase | None, **_: Any) -> TensorDictBase:
        flat = None if tensordict is None or GROUP not in tensordict else tensordict[GROUP].flatten(0, 1)
        return self._in_group(self.env._reset(flat))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._in_group(self.env._step(tensordict[GROUP].flatten(0, 1)))

    def _set_seed(self, seed: int | None) -> None:
        self.env._set_seed(seed)
