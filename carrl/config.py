"""Where the configuration lives, and how a node of it becomes an object.

What a person types may name any class or function that can be imported; what a run's folder says, only those that
`TARGETS` lists, unless the person trusts their module: `check_targets` is the border between the two.
"""

import importlib.util
import inspect
import pkgutil
import sys
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from carrl.errors import ConfigError, shown
from carrl.targets import TARGETS

_ADDED: set[str] = set()
"""The folders that were added to those in which Python looks for modules."""
MOST = 2.0**53
"""No number in a config may be larger, so that none overflows; floats tell whole numbers apart up to here."""
MOST_ITEMS = 4096
"""Of a list, or characters of a text, in a config."""


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


def foreign_targets(config: Mapping[str, Any]) -> dict[str, object]:
    """What a config names that is not CarRL's for its place, by place, such as "reward.comfort"."""
    return {
        place: target
        for group, node in config.items()
        for place, target in _targets(str(group), node)
        if target not in TARGETS.get(str(group), ())
    }


def _targets(place: str, node: Any) -> Iterator[tuple[str, object]]:
    for key, value in node.items() if isinstance(node, Mapping) else ():
        if key == "_target_":
            yield place, value
        else:
            yield from _targets(f"{place}.{key}", value)


def check_targets(config: Mapping[str, Any], trust: Iterable[str] = ()) -> None:
    """Lets nothing be built from the config of a run's folder but CarRL's own parts and those of trusted modules.

    Args:
        config: as it was read from the folder.
        trust: names of modules, or paths of their files, such as "parts" or "mine/parts.py".

    Raises:
        ConfigError: the config names something else, and the message says how to trust it; or it is of an older CarRL.
    """
    older = [key for key in ("action", "observation", "start") if key not in config]
    if older:
        raise ConfigError(
            f"it was trained by an older version of CarRL, which had no {', '.join(older)}; evaluate it with that "
            "version, or train anew"
        )
    trusted = [_importable_name(each) for each in trust]
    for place, target in foreign_targets(config).items():
        if not isinstance(target, str) or "." not in target:
            _refuse(place, target)
        if not _is_within(target, trusted):
            own = "" if target.startswith("carrl.") else f"; if you trust that module, add --trust {module_of(target)}"
            raise ConfigError(f"{place}._target_ is {shown(target)}, which is not one of CarRL's own{own}")
        if not _is_within(f"{getattr(_imported(place, target), '__module__', '')}.", trusted):
            raise ConfigError(f"{place}._target_ is {shown(target)}, which its module has only imported; name its own")


def _is_within(name: str, modules: Sequence[str]) -> bool:
    return any(name.startswith(f"{module}.") for module in modules)


def module_of(target: str) -> str:
    """The outermost module of a dotted name: what is to be trusted if it is to be called."""
    return target.partition(".")[0]


def _importable_name(module: str) -> str:
    """The name of a module that is given by its name or its file, which can then be imported."""
    path = Path(module)
    if path.suffix != ".py" and not (path / "__init__.py").is_file():
        make_importable_from([Path.cwd()])
        return module
    if not path.exists():
        raise ConfigError(f"the module to trust, '{module}', is no file; name one that is there, or a module")
    make_importable_from([path.absolute().parent])
    _load(path.stem, (path / "__init__.py" if path.is_dir() else path).resolve())
    return path.stem


def _load(name: str, file: Path) -> None:
    """Imports a module from this file, and no other one of its name."""
    check_is_no_other(name, file)
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ConfigError(f"'{file}' cannot be imported: it is no Python file")
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # of a person's own code
        del sys.modules[name]
        raise ConfigError(f"'{file}' cannot be imported: {type(error).__name__}: {error}") from error


def check_is_no_other(name: str, file: Path) -> None:
    """Raises ConfigError if a module of this name is imported from another file."""
    found = getattr(sys.modules.get(name), "__file__", None)
    if name in sys.modules and (found is None or Path(found).resolve() != file.resolve()):
        raise ConfigError(
            f"module {name} is imported already from {found or 'elsewhere'}, and not from {file}; rename one of them"
        )


def name_for_trust(module: str) -> str:
    """What to give for this module, once imported, to trust it: its name, or its file where that is found elsewhere."""
    file = getattr(sys.modules.get(module), "__file__", None)
    path = Path(file) if file else Path(module)
    path = path.parent if path.name == "__init__.py" else path
    is_here = path.parent == Path.cwd() or str(path.parent) not in _ADDED
    return module if is_here else str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def make_importable(config: Mapping[str, Any], folders: Iterable[Path]) -> None:
    """Lets modules here, in these folders and just above them be imported, if the config names any but CarRL's own."""
    targets, own = foreign_targets(config), [place for each in folders for place in (each, each.absolute().parent)]
    for name in {module_of(str(target)) for target in targets.values()}:
        files = [
            file for place in own for file in (place / f"{name}.py", place / name / "__init__.py") if file.is_file()
        ]
        if files:
            check_is_no_other(name, files[0])
    if targets:
        make_importable_from([Path.cwd(), *own])


def make_importable_from(folders: Iterable[Path]) -> None:
    """Lets modules in these folders be imported, unless another one of the same name comes first."""
    new = [each for each in dict.fromkeys(str(folder.absolute()) for folder in folders) if each not in sys.path]
    _ADDED.update(new)
    sys.path += new


def build_node(name: str, node: Mapping[str, Any], *, targets: Sequence[str] | None = None, **dependencies: Any) -> Any:
    """Calls a config node's `_target_` with the node's values and with what only the program knows.

    Args:
        name: the node's place in the config, for messages.
        node: `_target_`, unless there is but one of CarRL's own, and a value for each keyword that the user chooses.
        targets: CarRL's own; by default what `TARGETS` lists under its place.
        dependencies: keyword arguments that are objects, such as the network of a loss.

    Raises:
        ConfigError: the target cannot be, or a value has no place in it or another type than it wants.
    """
    target = _find_target(name, node, TARGETS.get(name, ()) if targets is None else targets)
    values = {key: value for key, value in node.items() if key != "_target_"}
    _check_values(name, target, values, dependencies)
    try:
        return target(**values, **dependencies)
    except ValueError as error:  # how torch's optimizers refuse a value
        raise ConfigError(f"{name}: {error}") from error


def build_terms(group: str, nodes: Mapping[str, Any]) -> dict[str, Any]:
    """The terms of a group such as `reward`, by name in their order; a term that is null is left out.

    Raises:
        ConfigError: as `build_node`, or the group is no mapping.
    """
    if not isinstance(nodes, Mapping):
        raise ConfigError(f"{group} is {shown(nodes)}; it must map names to terms")
    return {str(name): _build_term(group, name, node) for name, node in nodes.items() if node is not None}


def _build_term(group: str, name: Any, node: Mapping[str, Any]) -> Any:
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigError(f"{group} has a term called {shown(name)}; a term's name is made of letters, digits and _")
    return build_node(f"{group}.{name}", node, targets=TARGETS[group])


def as_mapping(name: str, node: Any) -> Mapping[str, Any]:
    """The node itself.

    Raises:
        ConfigError: it is no mapping.
    """
    if not isinstance(node, Mapping):
        raise ConfigError(f"{name} is {shown(node)}; it must be a mapping of keys to values")
    return node


def _find_target(name: str, node: Mapping[str, Any], own: Sequence[str]) -> Callable[..., Any]:
    path = as_mapping(name, node).get("_target_", own[0] if len(own) == 1 else None)
    if not isinstance(path, str) or "." not in path or (path.startswith("carrl.") and path not in own):
        _refuse(name, path)
    target: Callable[..., Any] = _imported(name, path)
    return target


def _imported(place: str, path: str) -> Any:
    try:
        found = pkgutil.resolve_name(path)
    except Exception as error:  # whatever its module raises as it is imported
        reason = f"{type(error).__name__}: {error}"
        raise ConfigError(f"{place}._target_ is {shown(path)}, which cannot be imported: {reason}") from error
    if not callable(found):
        raise ConfigError(f"{place}._target_ is {shown(path)}, which is no class or function")
    return found


def _refuse(name: str, target: object) -> NoReturn:
    own = TARGETS.get(name, TARGETS.get(name.partition(".")[0], ()))
    raise ConfigError(f"{name}._target_ is {shown(target)}; it must be {' or '.join(own)}")


def _check_values(
    name: str, target: Callable[..., Any], values: Mapping[str, Any], dependencies: Mapping[str, Any]
) -> None:
    function = target.__init__ if inspect.isclass(target) else target  # TorchRL's metaclasses hide the signature
    parameters = {key: each for key, each in inspect.signature(function).parameters.items() if key != "self"}
    chosen = [key for key in parameters if key not in dependencies]
    hints = typing.get_type_hints(function)
    for key, value in values.items():
        if key not in chosen:
            raise ConfigError(f"{name} has no key {shown(key)}; {target.__name__} takes {', '.join(chosen)}")
        if key in hints and not _fits(value, hints[key]):
            remedy = f"; write {shown(whole(value))}" if _fits(whole(value), hints[key]) else ""
            raise ConfigError(f"{name}.{key} is {shown(value)}; it must be {_wanted(hints[key])}{remedy}")
        _check_size(f"{name}.{key}", value)
    missing = [key for key in chosen if key not in values and parameters[key].default is inspect.Parameter.empty]
    if missing:
        raise ConfigError(f"{name} lacks {', '.join(missing)}; {target.__name__} needs a value for each")


def _wanted(hint: Any) -> str:
    """What a value of this type is, in words."""
    if typing.get_origin(hint) is typing.Literal:
        return " or ".join(map(str, typing.get_args(hint)))
    return f"of type {hint.__name__ if inspect.isclass(hint) else str(hint).replace('collections.abc.', '')}"


def is_whole_number(value: object) -> bool:
    """Whether this is a whole number; true and false are none, though Python counts with them."""
    return isinstance(value, int) and not isinstance(value, bool)


def whole(value: Any) -> Any:
    """The value with whole numbers for floats such as 1e5 that stand for one, in a list, too."""
    if isinstance(value, list):
        return [whole(item) for item in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _check_size(name: str, value: Any) -> None:
    """Raises ConfigError for numbers that are not finite or too large, and for texts and lists that are too long."""
    if isinstance(value, int | float) and not abs(value) <= MOST:  # nan fails it, too
        raise ConfigError(f"{name} is {shown(value)}; it must be a finite number of at most {MOST:.0f}")
    if isinstance(value, str | list) and len(value) > MOST_ITEMS:
        kind = "characters" if isinstance(value, str) else "items"
        raise ConfigError(f"{name} has {len(value)} {kind}; it may have at most {MOST_ITEMS}")
    for item in value if isinstance(value, list) else ():
        _check_size(name, item)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a plain YAML value may stand for a parameter of this type; a hint that is no type fits all."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, argument) for argument in arguments)
    if origin is typing.Literal:
        return value in arguments
    if origin is not None and issubclass(origin, Sequence):
        return isinstance(value, list) and all(_fits(item, arguments[0]) for item in value)
    if origin is not None and issubclass(origin, Mapping):
        return isinstance(value, dict) and all(
            _fits(part, hint) for item in value.items() for part, hint in zip(item, arguments, strict=True)
        )
    if hint in (int, float):
        return not isinstance(value, bool) and isinstance(value, int | hint)
    if hint is type(None):
        return value is None
    return not inspect.isclass(hint) or isinstance(value, hint)
