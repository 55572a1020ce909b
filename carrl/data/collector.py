"""Collects transitions from the environment.

Shapes: `N` cars.
"""

from typing import Any

from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

# Known as SyncDataCollector until torchrl 0.13; the old name is gone in 0.14.
from torchrl.collectors import Collector as SyncDataCollector

from carrl.data.cluster_collector import ClusterCollector
from carrl.data.limits import check_steps
from carrl.env.track_env import TrackEnv


def make_collector(steps_per_batch: int, *, env: TrackEnv, policy: TensorDictModuleBase) -> SyncDataCollector:
    """An endless iterator over batches of transitions, [N, steps_per_batch], from all cars of the environment.

    Raises:
        ConfigError: `steps_per_batch` is less than 1 or too large.
    """
    check_steps(steps_per_batch)
    return SyncDataCollector(
        env,
        policy,
        frames_per_batch=steps_per_batch * env.batch_size[0],
        total_frames=-1,
        trust_policy=True,
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )


def cars_of(collector: SyncDataCollector | ClusterCollector) -> dict[str, Any]:
    """Where every car is between two batches, [N] each: what the next batch begins with.

    TorchRL 0.14's `state_dict` of a collector leaves this out, and `load_state_dict` begins new episodes, as the
    cars of a cluster do.
    """
    if isinstance(collector, ClusterCollector):
        return collector.state_dict()
    return collector._carrier.select(*collector.env.observation_spec, *collector.env.done_spec).to_dict()


def put_cars_back(collector: SyncDataCollector | ClusterCollector, cars: dict[str, Any]) -> None:
    """Lets the next batch begin with these cars.

    Raises:
        KeyError, ValueError: the environment has no such cars.
    """
    if isinstance(collector, ClusterCollector):
        collector.load_state_dict(cars)
        return
    env = collector.env
    found = TensorDict(cars, batch_size=env.batch_size, device=env.device)
    if not (env.observation_spec.is_in(found.select(*env.observation_spec)) and env.done_spec.is_in(found)):
        raise ValueError("the environment has no such cars")
    collector._carrier.update(found)
