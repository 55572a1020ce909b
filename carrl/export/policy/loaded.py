"""Reads an exported policy back: `carrl.load_policy("policy.onnx")`."""

import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from carrl.errors import CarrlError, CheckpointError, ConfigError, shown
from carrl.export.policy.arrays import METADATA
from carrl.export.policy.graph import outputs_of
from carrl.files import read_whole

Arrays = dict[str, np.ndarray]
MAX_BYTES = 2**30
"""Of a file that is read; the greatest network has 256 MiB."""
RANGES = ("rays", "previous_rays")
"""Inputs of which an infinite value, or one that is not a number, is no echo."""


@dataclass(frozen=True)
class LoadedPolicy:
    """An exported policy: named inputs in physical units to the action and the controls.

    Attributes:
        metadata: what the file says of itself: `inputs`, `outputs`, `actions`, `controls`, `sensor`, `vehicle`,
            `control_period_s` and more.
    """

    metadata: Mapping[str, Any]
    _compute: Callable[[Arrays], Arrays] = field(repr=False)

    def __call__(self, **inputs: Any) -> Arrays:
        """The outputs, by name, of one car or of B.

        Args:
            inputs: by the names and of the shapes that `metadata["inputs"]` tells; with B in front for many cars.

        Raises:
            ConfigError: one is missing, unknown, of another shape or, but for rays, not finite, or there is no such
                action.
        """
        given = _arrays(inputs)
        wanted = {each["name"]: each for each in self.metadata["inputs"]}
        if given.keys() != wanted.keys():
            raise ConfigError(f"the policy's inputs are {', '.join(wanted)}, not {', '.join(given) or 'none'}")
        first = next(iter(wanted))
        is_one = given[first].ndim == len(wanted[first]["shape"])
        cars = (1,) if is_one else given[first].shape[:1]
        ready = {name: self._checked(given[name], each, cars, is_one) for name, each in wanted.items()}
        outputs = self._compute(ready)
        return {name: values[0] if is_one else values for name, values in outputs.items()}

    def _checked(
        self, values: np.ndarray, wanted: Mapping[str, Any], cars: tuple[int, ...], is_one: bool
    ) -> np.ndarray:
        """The values of an input [B, ...]."""
        name, shape = wanted["name"], (*(() if is_one else cars), *wanted["shape"])
        if values.shape != shape or values.dtype.kind not in "iuf":
            kind = f"{values.dtype} of the shape {list(values.shape)}"
            raise ConfigError(f"the policy's input {name} is {kind}; it must be numbers of the shape {list(shape)}")
        if wanted["dtype"] == "int64":
            most = len(self.metadata["actions"]) - 1
            if values.dtype.kind == "f" or not ((values >= 0) & (values <= most)).all():
                raise ConfigError(f"the policy's input {name} is {shown(values.tolist())}; actions are 0 to {most}")
        with np.errstate(over="ignore"):  # what is too much for float32 is infinite
            ready = np.ascontiguousarray(values.reshape(*cars, *wanted["shape"]), dtype=wanted["dtype"])
        if name not in RANGES and not np.isfinite(ready).all():
            raise ConfigError(f"the policy's input {name} is {shown(values.tolist())}; it must be finite")
        return ready

    def driver(self) -> "Driver":
        """What drives one car, or B at once, and remembers what the policy wants to know of the steps before."""
        return Driver(self)


class Driver:
    """Drives with a policy, step by step: `driver(rays=scan, speed=4.2)["controls"]`.

    It takes the inputs but for `last_action` and `previous_rays`, which it knows.

    Args:
        policy: that drives.
    """

    def __init__(self, policy: LoadedPolicy) -> None:
        self._policy = policy
        names = {each["name"]: each for each in policy.metadata["inputs"]}
        self._knows_action, self._scans = "last_action" in names, names.get("previous_rays", {"shape": [0]})["shape"][0]
        self.reset()

    def reset(self) -> None:
        """The next step is an episode's first one."""
        self._action: np.ndarray | None = None
        self._rays: np.ndarray | None = None

    def __call__(self, **inputs: Any) -> Arrays:
        """The outputs of one step; see `LoadedPolicy`.

        Raises:
            ConfigError: as `LoadedPolicy` does.
        """
        given = _arrays(inputs)
        if self._knows_action and "last_action" not in given:
            given["last_action"] = self._first_action(given) if self._action is None else self._action
        if self._scans and "rays" in given and "previous_rays" not in given:
            newest = np.atleast_1d(given["rays"])[..., None, :]
            given["previous_rays"] = np.repeat(newest, self._scans, axis=-2) if self._rays is None else self._rays
        outputs = self._policy(**given)
        self._action = outputs["action"]
        if self._scans:
            scans = [given["rays"][..., None, :], given["previous_rays"]]
            self._rays = np.concatenate(scans, axis=-2)[..., : self._scans, :]
        return outputs

    def _first_action(self, given: Mapping[str, Any]) -> np.ndarray:
        first = np.asarray(self._policy.metadata["first_action"])
        told = next((each for each in self._policy.metadata["inputs"] if each["name"] in given), None)
        if told is None:
            return first
        values = np.asarray(given[told["name"]])
        cars = values.shape[: max(0, values.ndim - len(told["shape"]))]
        return np.broadcast_to(first, (*cars, *first.shape))


def _arrays(inputs: Mapping[str, Any]) -> Arrays:
    arrays = {}
    for name, values in inputs.items():
        try:
            arrays[name] = np.asarray(values)
        except ValueError:  # rows of different lengths
            raise ConfigError(f"the policy's input {name} is no array; its rows must be of one length") from None
    return arrays


def load_policy(path: str | Path) -> LoadedPolicy:
    """Reads what `carrl export` wrote as `.onnx`, `.pt2` or `.npz`.

    A `.pt2` is read by torch, and may run code of whoever made it; the others run none.

    Raises:
        CarrlError: the file cannot be read, is no exported policy, or a package for it is missing.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".h":
        raise CarrlError(f"'{path}' is a C header, which is compiled; load a .onnx, .pt2 or .npz")
    if ending not in _READERS:
        raise CarrlError(f"'{path}' has no ending of an exported policy; it must end in {', '.join(_READERS)}")
    content = read_whole(path, MAX_BYTES, f"policy '{path}'", CheckpointError)
    try:
        policy = _READERS[ending](content)
        if policy.metadata.get("format") != "carrl-policy" or policy.metadata.get("format_version") != 1:
            raise ValueError("its metadata is of something else")
        policy(**{each["name"]: np.zeros(each["shape"], each["dtype"]) for each in policy.metadata["inputs"]})
    except CarrlError:
        raise
    except Exception as error:  # the libraries raise whatever they meet in a damaged file
        raise CheckpointError(f"policy '{path}' is damaged or not written by carrl export") from error
    return policy


def _read_arrays(content: bytes) -> LoadedPolicy:
    with zipfile.ZipFile(BytesIO(content)) as archive:
        if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
            raise ValueError("it unpacks to too much")
    with np.load(BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    document = json.loads(str(arrays.pop(METADATA)))
    return LoadedPolicy(document, lambda inputs: dict(outputs_of(document, arrays, inputs, np)))


def _read_program(content: bytes) -> LoadedPolicy:
    import torch

    from carrl.export.policy.program import METADATA as NAME

    files = {NAME: ""}
    module = torch.export.load(BytesIO(content), extra_files=files).module()

    def compute(inputs: Arrays) -> Arrays:
        with torch.no_grad():
            outputs = module({name: torch.from_numpy(values) for name, values in inputs.items()})
        return {name: values.numpy() for name, values in outputs.items()}

    return LoadedPolicy(json.loads(files[NAME]), compute)


def _read_onnx(content: bytes) -> LoadedPolicy:
    try:
        import onnxruntime
    except ImportError as error:
        raise CarrlError("ONNX needs onnxruntime, which is not installed; pip install 'carrl[onnx]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # of networks so small each further one costs time
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    document = json.loads(session.get_modelmeta().custom_metadata_map["carrl"])
    names = [each.name for each in session.get_outputs()]
    return LoadedPolicy(document, lambda inputs: dict(zip(names, session.run(names, inputs), strict=True)))


_READERS = {".onnx": _read_onnx, ".pt2": _read_program, ".npz": _read_arrays}
