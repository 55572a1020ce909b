"""Collects transitions from cars that are driven by the workers of a Ray cluster.

Shapes: `W` workers, `N` cars in all, of which each worker drives N / W; `T` steps of each car in a batch.
"""

import logging
import sys
import warnings
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from tensordict import TensorDictBase

from carrl.algorithms.algorithm import CollectPolicy
from carrl.data.collector import WorkerParts, check_steps
from carrl.data.ray_cluster import check_ray, check_room, ray_cluster
from carrl.env.track_env import TrackEnv
from carrl.errors import CarrlError, ConfigError

if TYPE_CHECKING:
    from torchrl.collectors.distributed import RayCollector

_logger = logging.getLogger(__name__)


class ClusterCollector:
    """An endless iterator over batches of transitions, [N, T], the first worker's cars first.

    Before each batch the workers are told what the policy has learnt, so all cars act as they would in one process. A
    worker that is lost, killed or with its machine, takes with it what all of them did for the batch under way: new
    workers are started, and every car begins a new episode, with random numbers not drawn before.

    Args:
        steps_per_batch: T.
        workers: W.
        address: of the cluster; see `ray_cluster`.
        env: with so many cars; the workers have environments of their own.
        policy: which the workers follow.
        seeds: of the replicates, one.
        parts: of a worker.

    Raises:
        ConfigError: the cars cannot be divided evenly among the workers, there are several replicates, or Ray is not
            installed.
    """

    may_break_off = True

    def __init__(
        self,
        steps_per_batch: int,
        workers: int,
        address: str | None,
        *,
        env: TrackEnv,
        policy: CollectPolicy,
        seeds: Sequence[int],
        parts: WorkerParts,
    ) -> None:
        if len(seeds) != 1:
            raise ConfigError("collector=ray trains one agent; leave trainer.seeds out, or set collector=sync")
        check_steps(steps_per_batch)
        cars = int(env.batch_size[0])
        if workers < 1 or cars % workers:
            raise ConfigError(
                f"collector.workers is {workers}; it must be at least 1 and divide the {cars} cars of env.num_envs"
            )
        check_ray()
        self._frames_per_batch, self._address = steps_per_batch * cars, address
        self._workers, self._cars, self._seed = workers, cars, seeds[0]
        self._parts, self._policy = parts, policy
        self._beginnings = 0
        self._batches: Generator[TensorDictBase] | None = None

    def cars(self) -> dict[str, Any]:
        """How often the cars have begun anew. Where they are is known to the workers alone."""
        return {"beginnings": self._beginnings}

    def load_cars(self, cars: dict[str, Any]) -> None:
        """Goes on with random numbers that were not drawn before; the cars begin new episodes."""
        self._beginnings = int(cars["beginnings"])

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Joins the cluster with the first batch, and leaves it with `shutdown`."""
        self._batches = self._collect()
        return self._batches

    def shutdown(self) -> None:
        """Ends the workers and, if it was started here, the cluster."""
        if self._batches is not None:
            self._batches.close()

    def _collect(self) -> Generator[TensorDictBase]:
        with ray_cluster(self._address, self._workers):
            while True:
                yield from self._collect_until_a_loss()
                check_room(self._workers)

    def _collect_until_a_loss(self) -> Iterator[TensorDictBase]:
        """Batches until a worker is lost.

        Raises:
            CarrlError: it is lost before the first batch, so that others would fare no better.
        """
        from ray.exceptions import RayActorError

        began = False
        with self._begin() as collector:
            batches = iter(collector)
            while True:
                try:
                    collector.map_fn("policy.load_shared_state", [(self._policy.shared_state(),)] * self._workers)
                    with _without_remarks():
                        batch = next(batches)
                except RayActorError as error:
                    if not began:
                        raise CarrlError(f"a Ray worker ended before its first batch: {error}") from error
                    _logger.warning(
                        "A Ray worker was lost; its and the others' cars begin new episodes on new workers."
                    )
                    return
                began = True
                yield batch.flatten(0, 1).to(self._policy.device)

    @contextmanager
    def _begin(self) -> Iterator["RayCollector"]:
        """New workers with their cars at the start of an episode."""
        from torchrl.collectors.distributed import RayCollector

        self._beginnings += 1
        cars, seeds = self._cars // self._workers, self._worker_seeds()
        with _without_remarks():
            collector = RayCollector(
                [partial(self._parts.make_env, cars, seed) for seed in seeds],
                policy_factory=[partial(self._parts.make_policy, seed) for seed in seeds],
                # One for each: torchrl 0.14.1 writes each worker's policy into them, which would all be the last one's.
                collector_kwargs=[{"track_traj_ids": False, "auto_register_policy_transforms": False} for _ in seeds],
                frames_per_batch=self._frames_per_batch,
                total_frames=sys.maxsize,  # torchrl 0.14.1 collects nothing at all for its default, -1
                trust_policy=True,
                sync=True,
                remote_configs={"num_cpus": 1, "num_gpus": 0},
                # The default sends weights by torch.distributed, whose store listens to the whole network and whose
                # group does not outlive a member. Here Ray carries them, see `_collect_until_a_loss`.
                weight_sync_schemes={},
            )
        try:
            yield collector
        finally:
            collector.shutdown()

    def _worker_seeds(self) -> list[int]:
        sequence = np.random.SeedSequence([self._seed, self._beginnings])
        return [int(seed) for seed in sequence.generate_state(self._workers)]


@contextmanager
def _without_remarks() -> Iterator[None]:
    """Keeps quiet what TorchRL 0.14 remarks to all who send weights on their own, as its warnings say they may."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The policy is not an nn.Module", UserWarning)
        warnings.filterwarnings("ignore", "RayCollector iteration started before weight", UserWarning)
        yield
