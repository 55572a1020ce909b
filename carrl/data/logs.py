"""Logs of earlier runs as what there is to learn from, and as one of TorchRL's offline data sets.

Shapes: `T` transitions, `A` replicates, which all learn from the same ones; `E` episodes, `L` steps of the longest.
"""

import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import ImmutableDatasetWriter, TensorDictReplayBuffer, TensorStorage
from torchrl.data.datasets import BaseDatasetExperienceReplay
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.writers import Writer
from torchrl.envs.transforms import Transform

from carrl.data.replay_buffer import KEYS
from carrl.errors import LogError
from carrl.log import Log, fill
from carrl.sim.sensor import Sensor
from carrl.task.action import ActionMap, in_words
from carrl.task.task import World

Numbers = NDArray[np.float64]


def check_logs(paths: Sequence[Path], world: World) -> int:
    """How many transitions the logs hold in all, each seen as a car with these sensors would.

    Only the logs' indices, metadata and ends are read.

    Args:
        paths: of the logs.
        world: whose observations the network is to understand, and whose actions it chooses among.

    Raises:
        LogError: a log is missing or damaged, or was written by a car with other sensors or actions.
    """
    total = 0
    for path in paths:
        with Log(path) as log:
            if log.transitions:
                _check_width(log, world)
            _check_sensor(log, world.sensor)
            _check_parts(log, world)
            _check_actions(log, world)
            total += log.transitions
    return total


def fill_from_logs(buffer: TensorDictReplayBuffer, paths: Sequence[Path], replicates: int, action: ActionMap) -> None:
    """Puts every transition of the logs into the memories of all replicates, a message at a time.

    Raises:
        LogError: a log is damaged, or has an action that there is not.
    """
    for path in paths:
        memories: Any = _Memories(buffer, replicates, path, action)
        fill(memories, path)


class _Memories:
    """The way of a log's transitions into a buffer."""

    def __init__(self, buffer: TensorDictReplayBuffer, replicates: int, path: Path, action: ActionMap) -> None:
        self._buffer, self._replicates, self._path = buffer, replicates, path
        self._action = action

    def extend(self, transitions: TensorDictBase) -> None:
        """Stores transitions [T] once for each replicate, [T, A]."""
        action, spec = transitions["action"], self._action.spec
        wanted = (*transitions.batch_size, *spec.shape)
        if action.shape != wanted or not spec.expand(wanted).is_in(action):
            raise LogError(
                f"log '{self._path}': has actions {action.min()}..{action.max()}; each must be {in_words(self._action)}"
            )
        self._buffer.extend(transitions.select(*KEYS)[:, None].expand(len(transitions), self._replicates))


def _check_width(log: Log, world: World) -> None:
    found = log.schema.by_name["observation"].width
    if found != world.observation_size:
        parts = world.observation.parts(world.sensor, world.action)
        raise LogError(
            f"log '{log.path}': its observations have {found} values, the network reads {world.observation_size} "
            f"({', '.join(f'{part.width} of {part.name}' for part in parts)}); "
            "set sensor.rays and observation as in the run that wrote it"
        )


def _check_sensor(log: Log, sensor: Sensor) -> None:
    reach = _numbers(log, "sensor_range_m", sensor.max_range)
    if not _alike(reach, sensor.max_range):
        raise LogError(
            f"log '{log.path}': its sensor reaches {reach} m, this configuration's {sensor.max_range} m; "
            f"set sensor.max_range={reach}"
        )
    mount = _numbers(log, "sensor_mount_m", 0.0)
    if "sensor_range_m" in log.metadata and not _alike(mount, sensor.mount):
        raise LogError(
            f"log '{log.path}': its rays begin {mount} m ahead of the car's middle, this configuration's "
            f"{sensor.mount} m; set sensor.mount={mount}"
        )
    angles = sensor.angles.numpy()
    found = _numbers(log, "sensor_angles_rad", angles)
    if not _alike(found, angles):
        raise LogError(
            f"log '{log.path}': its sensor has {_fan(found)}, this configuration's {_fan(angles)}; "
            "set sensor.rays, sensor.field_of_view and sensor.turn as in the run that wrote it"
        )


def _check_parts(log: Log, world: World) -> None:
    """Raises LogError where observations that are as wide are of other terms."""
    own = [(part.name, part.width) for part in world.observation.parts(world.sensor, world.action)]
    try:
        found = [(name, width) for name, width, *_ in _entry(log, "observation", own)]
    except (TypeError, ValueError) as error:
        raise LogError(
            f"log '{log.path}': its metadata entry 'observation' names no terms; give an intact log"
        ) from error
    if found != own:
        there, here = (", ".join(f"{width} of {name}" for name, width in parts) for parts in (found, own))
        raise LogError(
            f"log '{log.path}': its observations are {there:.200}, the network reads {here}; "
            "set observation as in the run that wrote it"
        )


def _check_actions(log: Log, world: World) -> None:
    own = list(world.action.names)
    names = _entry(log, "action_names", own)
    if names != own:
        raise LogError(
            f"log '{log.path}': its actions are {names or 'numbers'!s:.100}, this car's are {own or 'numbers'}; "
            "give the log of a car with the same"
        )
    controls = list(world.action.control_names)
    found = _entry(log, "control_names", controls)
    if not own and found != controls:
        raise LogError(
            f"log '{log.path}': its actions are numbers for {found!r:.100}, this car's for {controls}; "
            "give the log of a car with the same"
        )


def _numbers(log: Log, key: str, default: Any) -> Numbers:
    try:
        return np.asarray(_entry(log, key, default), dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise LogError(f"log '{log.path}': its metadata entry '{key}' holds no numbers; give an intact log") from error


def _entry(log: Log, key: str, default: Any) -> Any:
    """What the log's metadata says under a key; the default where it says nothing."""
    try:
        return json.loads(log.metadata[key]) if key in log.metadata else default
    except (ValueError, RecursionError) as error:
        raise LogError(f"log '{log.path}': its metadata entry '{key}' is not JSON; give an intact log") from error


def _alike(found: Numbers, wanted: Any) -> bool:
    """Whether these are the same numbers up to rounding."""
    return found.shape == np.shape(wanted) and bool(np.allclose(found, wanted, rtol=1e-5, atol=1e-6))


def _fan(angles: Numbers) -> str:
    return f"{angles.size} rays over {math.degrees(np.ptp(angles)):.0f} degrees" if angles.size else "no rays"


class CarRLExperienceReplay(BaseDatasetExperienceReplay):
    """Samples the transitions of a log, in the layout that TorchRL's other data sets have.

    The first time, the log is copied into memory-mapped tensors, some thousands of transitions at a time; from then on
    it costs no more memory than what is sampled. Cars that drove side by side alternate in a log; here the transitions
    stand episode by episode, in the order of `episode` and `step`, so that slices of trajectories can be sampled, too:
    `SliceSampler(num_slices=4, traj_key="episode")`. The keys are those of `carrl.log.load`, and `done`, `terminated`
    and `truncated` before each step, which are never true. An episode that was under way when the log ends has no
    transition that is done.

    Args:
        dataset_id: the log's path.
        batch_size: how many transitions a sample has; episodes, with `split_trajs`.
        root: folder for the copies; `~/.cache/torchrl/carrl` by default. A log that has changed is copied anew.
        sampler: uniform, with replacement, by default.
        writer: refuses to write by default.
        collate_fn: merges a list of transitions into a sample.
        pin_memory: whether to pin the samples' memory.
        prefetch: how many samples to make ahead, in threads.
        transform: of every sample.
        split_trajs: make an item of every episode, [L], padded with zeros; `mask` says which steps there are.

    Raises:
        LogError: the log is missing, damaged or empty, or its copy cannot be written.
    """

    def __init__(
        self,
        dataset_id: str | Path,
        batch_size: int | None = None,
        *,
        root: str | Path | None = None,
        sampler: Sampler | None = None,
        writer: Writer | None = None,
        collate_fn: Callable[..., Any] | None = None,
        pin_memory: bool = False,
        prefetch: int | None = None,
        transform: Transform | None = None,
        split_trajs: bool = False,
    ) -> None:
        """Copies the log unless that was done before."""
        self.dataset_id = str(dataset_id)
        self.root = Path.home() / ".cache" / "torchrl" / "carrl" if root is None else root
        self.split_trajs = split_trajs
        self._name = _name_of(Path(dataset_id))
        if not self._is_downloaded():
            _copy(Path(dataset_id), self.data_path, split_trajs)
        super().__init__(
            storage=TensorStorage(TensorDict.load_memmap(self.data_path, allow_pickle=False)),
            sampler=sampler,
            writer=ImmutableDatasetWriter() if writer is None else writer,
            collate_fn=collate_fn,
            pin_memory=pin_memory,
            prefetch=prefetch,
            batch_size=batch_size,
            transform=transform,
        )

    @property
    def data_path_root(self) -> Path:
        """The copy of the transitions one by one."""
        return Path(self.root) / self._name

    @property
    def data_path(self) -> Path:
        """The copy that is sampled, and that `delete` removes; never the log itself."""
        return self.data_path_root.with_name(f"{self._name}_split") if self.split_trajs else self.data_path_root

    def _is_downloaded(self) -> bool:
        """Whether the copy is there."""
        return self.data_path.is_dir()


def _name_of(path: Path) -> str:
    """A name that tells a log from all others, and from itself before it was changed."""
    try:
        place, status = path.resolve(), path.stat()
    except OSError as error:
        raise LogError(f"log '{path}': cannot be read: {error.strerror}; give the train.mcap of a run") from error
    identity = f"{place} {status.st_size} {status.st_mtime_ns}"
    return f"{path.stem}-{hashlib.sha256(identity.encode()).hexdigest()[:16]}"


def _copy(log_path: Path, target: Path, split: bool) -> None:
    """Copies a log into memory-mapped tensors, whole or not at all."""
    index = _index(log_path, split)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, ignore_cleanup_errors=True) as folder:
            partial = Path(folder) / "copy"
            rows: Any = _Rows(partial, index)
            fill(rows, log_path)
            if target.exists():  # another process was faster
                shutil.rmtree(partial)
            else:
                os.replace(partial, target)
    except OSError as error:
        raise LogError(
            f"log '{log_path}': its copy in '{target.parent}' cannot be written: {error.strerror}; give another root"
        ) from error


def _index(log_path: Path, split: bool) -> tuple[Tensor, ...]:
    """Where each transition goes, in the order of the log: [T], or with `split` episode [T] and step [T]."""
    with Log(log_path) as log:
        numbers = [columns["episode"] for columns in log.batches()]
    if not numbers:
        raise LogError(f"log '{log_path}': holds no transitions; give one that does")
    _, episode, lengths = np.unique(np.concatenate(numbers), return_inverse=True, return_counts=True)
    row = np.empty_like(episode)
    row[np.argsort(episode, kind="stable")] = np.arange(len(episode))
    if not split:
        return (torch.from_numpy(row),)
    begins = np.cumsum(lengths) - lengths
    return torch.from_numpy(episode), torch.from_numpy(row - begins[episode])


class _Rows:
    """Memory-mapped tensors that take up a log's transitions, each in its place."""

    def __init__(self, path: Path, index: tuple[Tensor, ...]) -> None:
        self._path, self._index = path, index
        self._memory: TensorDictBase | None = None
        self._filled = 0

    def extend(self, transitions: TensorDict) -> None:
        """Stores the next transitions of the log."""
        for flag in ("done", "terminated", "truncated"):
            transitions[flag] = torch.zeros_like(transitions["next", flag])
        if len(self._index) > 1:
            transitions["mask"] = torch.ones(len(transitions), dtype=torch.bool)
        if self._memory is None:
            shape = [int(places.max()) + 1 for places in self._index]
            self._memory = transitions[0].expand(*shape).memmap_like(self._path)
        end = self._filled + len(transitions)
        self._memory[tuple(places[self._filled : end] for places in self._index)] = transitions
        self._filled = end
