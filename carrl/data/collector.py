"""Collects transitions from the environment.

Shapes: `N` cars.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase

# Known as SyncDataCollector until torchrl 0.13; the old name is gone in 0.14.
from torchrl.collectors import Collector as SyncDataCollector
from torchrl.envs.utils import set_exploration_type

from carrl.algorithms.algorithm import CollectPolicy
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError

MOST_STEPS = 2**16
"""Of each car in a batch."""


class Collector(Protocol):
    """An endless iterator over batches of transitions, [N, steps].

    Attributes:
        may_break_off: whether cars may begin a new episode although the last one has not ended.
    """

    may_break_off: bool

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Begins to collect."""

    def cars(self) -> dict[str, Any]:
        """Where every car is between two batches."""

    def load_cars(self, cars: dict[str, Any]) -> None:
        """Lets the next batch begin with these cars.

        Raises:
            ValueError: there are no such cars.
        """

    def shutdown(self) -> None:
        """Ends it."""


@dataclass(frozen=True)
class WorkerParts:
    """What another process that collects drives with, made there, on the CPU.

    Attributes:
        make_env: an environment of so many cars, whose random numbers are drawn from this seed.
        make_policy: a copy of the policy, with random numbers from this seed.
    """

    make_env: Callable[[int, int], TrackEnv]
    make_policy: Callable[[int], CollectPolicy]


class CarCollector(SyncDataCollector):
    """An endless iterator over batches of transitions, [N, steps], whose cars can be put where they were.

    TorchRL 0.14's `state_dict` of a collector leaves out where they are, and `load_state_dict` begins new episodes.
    """

    may_break_off = False
    _carrier: TensorDictBase

    def iterator(self) -> Iterator[TensorDictBase]:
        """One batch after the other; none is changed later, so that there is no need to copy them as TorchRL does."""
        while True:
            yield self.rollout()

    @torch.no_grad()
    def rollout(self) -> TensorDictBase:
        """The next batch, [N, steps].

        It has what TorchRL 0.14's own has (a test compares them), whose many cases take longer than the step itself:
        cars and policy are on one device, and there are no random actions to begin with.
        """
        steps = []
        with set_exploration_type(self.exploration_type):
            for _ in range(self.frames_per_batch):  # of each car: TorchRL has divided by their number
                step, self._carrier = self.env.step_and_maybe_reset(self.policy(self._carrier))
                steps.append(step)
        return steps[0].unsqueeze(-1) if len(steps) == 1 else torch.stack(steps, dim=-1)

    def cars(self) -> dict[str, Any]:
        """Where every car is between two batches, [N] each: what the next batch begins with."""
        return self._carrier.select(*self.env.observation_spec, *self.env.done_spec).to_dict()

    def load_cars(self, cars: dict[str, Any]) -> None:
        """Lets the next batch begin with these cars.

        Raises:
            ValueError: the environment has no such cars.
        """
        env = self.env
        found = TensorDict(cars, batch_size=env.batch_size, device=env.device)
        if not (env.observation_spec.is_in(found.select(*env.observation_spec)) and env.done_spec.is_in(found)):
            raise ValueError("the environment has no such cars")
        self._carrier.update(found)


def make_collector(
    steps_per_batch: int,
    *,
    env: TrackEnv,
    policy: TensorDictModuleBase,
    seeds: Sequence[int] = (),
    parts: WorkerParts | None = None,
) -> CarCollector:
    """A collector of batches, [N, steps_per_batch], from all cars of the environment, in this process.

    It has no use for `seeds` and `parts`, which are those of `ClusterCollector`.

    Args:
        steps_per_batch: steps of each car between two rounds of updates.
        env: whose cars drive.
        policy: that drives them.
        seeds: of the replicates.
        parts: what another process would make.

    Raises:
        ConfigError: `steps_per_batch` is less than 1 or too large.
    """
    check_steps(steps_per_batch)
    return CarCollector(
        env,
        policy,
        frames_per_batch=steps_per_batch * env.batch_size[0],
        total_frames=-1,
        trust_policy=True,
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )


def check_steps(steps_per_batch: int) -> None:
    """Raises ConfigError where a batch has no steps, or too many."""
    if not 1 <= steps_per_batch <= MOST_STEPS:
        raise ConfigError(
            f"collector.steps_per_batch is {steps_per_batch}; it must be at least 1 and at most {MOST_STEPS}"
        )
