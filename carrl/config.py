"""Where the configuration lives, and how a node of it becomes an object."""

import inspect
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.utils import get_object

from carrl.errors import ConfigError

ALLOWED_TARGETS = ("carrl.", "torch.optim.")
"""What a config may build must be defined in here: a run's folder can come from a stranger."""


def config_dir() -> Path:
    """The folder of the YAML files: inside the package when installed, beside it in a checkout.

    Raises:
        ConfigError: neither is there.
    """
    package = Path(__file__).resolve().parent
    candidates = (package / "conf", package.parent / "conf")
    for candidate in candidates:
        if (candidate / "train.yaml").is_file():
            return candidate
    raise ConfigError(f"no configuration: neither {candidates[0]} nor {candidates[1]} holds train.yaml; install again")


def build_node(name: str, node: Mapping[str, Any], **dependencies: Any) -> Any:
    """Calls a config node's `_target_` with the node's values and with what only the program knows.

    Args:
        name: the node's place in the config, for messages.
        node: `_target_`, and one value for each keyword that the user may choose.
        dependencies: keyword arguments that are objects, such as the network of a loss.

    Raises:
        ConfigError: the target is not allowed, or a value has no place in it or another type than it wants.
    """
    target = _find_target(name, node)
    values = {key: value for key, value in node.items() if key not in ("_target_", "_partial_")}
    _check_values(name, target, values)
    try:
        return target(**values, **dependencies)
    except ValueError as error:  # how torch's optimizers refuse a value
        raise ConfigError(f"{name}: {error}") from error


def _find_target(name: str, node: Mapping[str, Any]) -> Callable[..., Any]:
    path = str(node.get("_target_")) if isinstance(node, Mapping) else None
    if path is None or not path.startswith(ALLOWED_TARGETS):
        raise ConfigError(f"{name}._target_ is '{path}'; it must begin with {' or '.join(ALLOWED_TARGETS)}")
    try:
        target = get_object(path)
    except Exception as error:
        raise ConfigError(f"{name}._target_ is '{path}', which cannot be found") from error
    home = f"{getattr(target, '__module__', '')}."
    if not callable(target) or not home.startswith(ALLOWED_TARGETS):  # carrl.config.inspect.os.system, say
        raise ConfigError(f"{name}._target_ is '{path}', which is not a part of {' or '.join(ALLOWED_TARGETS)}")
    return target


def _check_values(name: str, target: Callable[..., Any], values: Mapping[str, Any]) -> None:
    function = target.__init__ if inspect.isclass(target) else target  # TorchRL's metaclasses hide the signature
    parameters = [parameter for parameter in inspect.signature(function).parameters if parameter != "self"]
    hints = typing.get_type_hints(function)
    for key, value in values.items():
        if key not in parameters:
            raise ConfigError(f"{name} has no key '{key}'; {target.__name__} takes {', '.join(parameters)}")
        if key in hints and not _fits(value, hints[key]):
            wanted = getattr(hints[key], "__name__", None) if inspect.isclass(hints[key]) else None
            raise ConfigError(f"{name}.{key} is {value!r}; it must be of type {wanted or hints[key]}")


def _fits(value: Any, hint: Any) -> bool:
    """Whether a plain YAML value may stand for a parameter of this type; a hint that is no type fits all."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, argument) for argument in arguments)
    if origin is typing.Literal:
        return value in arguments
    if origin is not None and issubclass(origin, Sequence):
        return isinstance(value, list) and all(_fits(item, arguments[0]) for item in value)
    if hint in (int, float):
        return not isinstance(value, bool) and isinstance(value, int | hint)
    if hint is type(None):
        return value is None
    return not inspect.isclass(hint) or isinstance(value, hint)
