"""Joins a Ray cluster, or starts one on this machine."""

import importlib.util
import ipaddress
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from carrl.errors import ConfigError

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
