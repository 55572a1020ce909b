"""Collects transitions from cars that are driven by the workers of a Ray cluster.

Shapes: `W` workers, `N` cars in all, of which each worker drives N / W; `T` steps of each car in a batch.
"""

import importlib.util
import ipaddress
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
import warnings
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from tensordict import TensorDictBase

from carrl.algorithms.algorithm import CollectPolicy
from carrl.data.collector import WorkerParts, check_steps
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
            raise ConfigError("collector=ray trains one replicate; leave trainer.seeds out, or set collector=sync")
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


OBJECT_STORE_BYTES = 128 * 2**20
"""Shared memory of a local cluster; a batch is a few hundred kilobytes."""
CONNECT_TIMEOUT_S = 5.0
_QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}


def check_ray() -> None:
    """Raises ConfigError where Ray is not installed."""
    if importlib.util.find_spec("ray") is None:
        raise ConfigError("collector=ray needs ray; pip install 'carrl[ray]'")


@contextmanager
def ray_cluster(address: str | None, workers: int) -> Iterator[None]:
    """While it is open, this process belongs to a Ray cluster.

    Args:
        address: of a running cluster, `HOST:PORT`, or `auto` for the one of this machine; None starts one that listens
            to this machine alone, has a processor for each worker and ends with the process.
        workers: how many will run there at once, each on a processor of its own.

    Raises:
        ConfigError: there is no such cluster, or it has too few processors.
    """
    import ray

    with tempfile.TemporaryDirectory(prefix="carrl-", dir=_short_folder(), ignore_cleanup_errors=True) as folder:
        try:
            with _keeping_handler_of_sigterm():
                if address is None:
                    _start(workers, folder)
                else:
                    _join(address)
            check_room(workers)
            yield
        finally:
            ray.shutdown()


def check_room(workers: int) -> None:
    """Raises ConfigError where a cluster has too few processors, for whose sake Ray would wait for ever."""
    import ray

    processors = int(ray.cluster_resources().get("CPU", 0))
    if processors < workers:
        raise ConfigError(
            f"collector.workers is {workers}, but the Ray cluster has {processors} processors; "
            "set fewer, or add machines to it, and go on with resume= where a run was under way"
        )


def _join(address: str) -> None:
    import ray

    try:
        with ExitStack() as stack:
            if address != "auto" and _is_of_this_machine(address):
                stack.enter_context(_within_this_machine())
            ray.init(address=address, **_QUIET)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            f"collector.address is '{address}', where no Ray cluster answers: {error}; "
            "give HOST:PORT as `ray start --head` prints it, or auto on a machine of the cluster, or null"
        ) from error


def _is_of_this_machine(address: str) -> bool:
    """Whether the address is within this machine; Ray itself would wait half a minute for an answer.

    Raises:
        OSError, ValueError: nothing answers there, or this is no address.
    """
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S) as connection:
        return ipaddress.ip_address(connection.getpeername()[0]).is_loopback


def _start(processors: int, folder: str) -> None:
    """Starts a cluster whose every port is open to this machine alone, and which reports to nobody."""
    import ray

    options: dict[str, Any] = {"include_dashboard": False, "object_store_memory": OBJECT_STORE_BYTES, "num_gpus": 0}
    with _within_this_machine():
        ray.init(address="local", num_cpus=processors, _temp_dir=folder, **options, **_QUIET)


@contextmanager
def _within_this_machine() -> Iterator[None]:
    """Lets Ray listen, and look for others, at 127.0.0.1.

    Ray 2.60 takes `127.0.0.1`, as an address or as `_node_ip_address`, for the machine's address in the network, unless
    it is told that there are no clusters, by a variable that it reads when it is imported (and TorchRL imports it).
    """
    from ray._private import ray_constants

    enabled = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        with _environment(RAY_USAGE_STATS_ENABLED="0", RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER="0"):
            yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = enabled


@contextmanager
def _environment(**variables: str) -> Iterator[None]:
    """Sets these while it is open, for processes started meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _keeping_handler_of_sigterm() -> Iterator[None]:
    """Puts the handler back that `ray.init` replaces by one that ends the process at once, with nothing saved."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def _short_folder() -> str | None:
    """Where temporary folders have names short enough for sockets, of 107 characters at most."""
    return "/tmp" if os.path.isdir("/tmp") else None
