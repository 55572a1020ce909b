"""From overrides to a configuration as plain values, and what was meant by a key or an option that there is not.

Nothing here waits for torch, so that a misspelt key is answered at once.
"""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from carrl.config import config_dir, make_importable
from carrl.errors import CLOSE, ConfigError, did_you_mean, shown
from carrl.plain_yaml import parse_yaml
from carrl.targets import TARGETS

PLAIN_KEYS = {
    "seed": "of everything random in the run: network, exploration, environment, replay sampling",
    "device": "`cpu` or `cuda`: where the cars drive and the network learns",
    "compile": "make the updates in native code, about ten times faster; else eagerly, the same but for rounding",
    "threads": "CPU threads of torch; more do not help a network this small",
    "resume": "a run's folder, to go on with it, or for longer: `carrl train resume=RUN trainer.frames=500000`",
    "search": "what `carrl tune` searches among; training does not read it",
}
"""Keys of the configuration that are no groups, and what they are."""
MAY_BE_EMPTY = ("learning_rate", "logger", "data", "opponents")
"""Groups of which an option may have no keys."""
MAY_BE_ABSENT = (*MAY_BE_EMPTY, "gradient_clipping", "returns", "recorder", "resume", "search")
_OTHERS_CALL_IT = {
    "learning_rate": "optimizer.lr",
    "batch": "replay_buffer.batch_size",
    "buffer_size": "replay_buffer.capacity",
    "num_steps": "trainer.frames",
    "timesteps": "trainer.frames",
    "total_timesteps": "trainer.frames",
}
_MOST = 3


def composed(overrides: Sequence[str], own_folder: Path | None = None) -> dict[str, Any]:
    """The resolved configuration with these overrides, as Hydra reads them.

    Args:
        overrides: such as `loss=dqn`.
        own_folder: a folder of groups and experiments of one's own.

    Raises:
        ConfigError: there is none.
    """
    own = [] if own_folder is None else [f"hydra.searchpath=[{quote(f'file://{own_folder.absolute()}')}]"]
    try:
        with initialize_config_dir(str(config_dir()), version_base="1.3"):
            config = compose("train", [*overrides, *own])
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(explain(error)) from error
    return plain(config, () if own_folder is None else (own_folder,))


def plain(config: DictConfig, folders: Iterable[Path] = ()) -> dict[str, Any]:
    """A composed configuration as plain values, checked: everything in it is read by something.

    Args:
        config: as Hydra composed it.
        folders: where modules may lie, besides the current folder, whose parts it names.

    Raises:
        ConfigError: a value is missing or refers to none, or a key is known to nobody.
    """
    try:
        missing = sorted(OmegaConf.missing_keys(config))
        if missing:
            what = "RUN" if missing[0].endswith(".run") else "FILE"
            raise ConfigError(f"{missing[0]} has no value; give it one, as in carrl train ... {missing[0]}={what}")
        values: dict[str, Any] = OmegaConf.to_container(config, resolve=True)  # type: ignore[assignment]
    except OmegaConfBaseException as error:
        raise ConfigError(explain(error)) from error
    check_keys(values)
    make_importable(values, folders)
    return values


def quote(text: str) -> str:
    """The text such as Hydra reads it back, whatever is in it."""
    return "'" + re.sub(r"(\\*)('|$)", lambda found: found[1] * 2 + ("\\'" if found[2] else ""), text) + "'"


def check_keys(config: Mapping[str, Any]) -> None:
    """Raises ConfigError where the configuration has a key that nothing reads, or lacks one that training needs."""
    for key, value in config.items():
        if key not in TARGETS and key not in PLAIN_KEYS:
            name = next(iter(_leaves(str(key), value)))
            raise ConfigError(f"there is no key {shown_key(name)}{did_you_mean_key(name)}")
        if key in TARGETS and not isinstance(value, Mapping | None):
            keys = [name for name in real_keys() if name.startswith(f"{key}.")]
            leave = f", or {key}=null to leave it out" if key in MAY_BE_ABSENT else ""
            raise ConfigError(
                f"{key} is {shown(value)}, but it is made of keys; set {' or '.join(keys[:_MOST])}{leave}"
            )
        if key in MAY_BE_EMPTY and isinstance(value, Mapping) and value and "_target_" not in value:
            choice = ", ".join(f"{key}={option}" for option in options_with(key, "_target_:"))
            raise ConfigError(f"{key}.{next(iter(value))} has no effect, as no {key} is chosen; add one of: {choice}")
    for key in (*TARGETS, *PLAIN_KEYS):
        if key not in MAY_BE_ABSENT and config.get(key) is None:
            options = options_with(key)
            remedy = f"choose {key}={'|'.join(options)}" if options else f"write {key}=VALUE"
            if key in TARGETS and not options:
                remedy = f"do not delete it, nor write {key}=null"
            raise ConfigError(f"{key} is left out, but training needs it; {remedy}")
    if config.get("resume") is not None:
        run = shown(config["resume"])
        raise ConfigError(f"resume is {run}; it counts only where it is typed, as in carrl train resume=RUN")


def explain(error: Exception) -> str:
    """What Hydra's error says, in one sentence, with what was meant if that can be guessed."""
    text = " ".join(str(error).split())
    if isinstance(error, YAMLError):
        return f"a file of the configuration is no YAML that Hydra reads: {text}"
    missing = re.match(r"(?:In '[^']*': )?Could not find '([^']*)/([^']*)'", text)
    if isinstance(error, MissingConfigException) and missing and error.options:
        group, option = missing.groups()
        return no_such_option(group, option, error.options)
    unknown = re.match(r"Could not (?:override|delete|remove)(?: from config)?\.? *(?:'([^']*)')?", text)
    if unknown is None or not unknown[1]:
        return text
    key = unknown[1].partition("@")[0]
    if key in real_keys():
        group = key.partition(".")[0]
        options = [f"{group}={option}" for option in options_with(group) if key in real_keys(group, option)]
        choice = "one of these" if options[1:] else "it"
        *others, last = options
        them = f"{', '.join(others)} and {last}" if others else last
        return f"{key} is a key of {them} only; choose {choice}, too"
    return f"there is no key {shown_key(key)}{did_you_mean_key(key)}"


def no_such_option(group: str, option: str, options: Iterable[str]) -> str:
    """A sentence on an option that a group does not have."""
    says = f"{group} has no option {option}"
    if group in _OTHERS_CALL_IT and re.fullmatch(r"[\d.eE+-]+", option):
        return f"{says}; did you mean {_OTHERS_CALL_IT[group]}={option}?"
    close = did_you_mean(option, options)
    return f"{says}{close.rstrip('?') + ', or' if close else '; choose'} one of: {', '.join(sorted(options))}"


def did_you_mean_key(key: str) -> str:
    """The rest of a sentence that names the real keys nearest to this one; how to find them if none is near."""
    close = nearest_keys(key)
    shows = "hydra" if key.startswith("hydra") else "job"
    return f"; did you mean {' or '.join(close)}?" if close else f"; carrl train --cfg {shows} shows all there are"


def nearest_keys(key: str) -> list[str]:
    """The real keys that may have been meant: those of the same last name, else those spelt most alike."""
    key = key.replace("-", "_").strip("+~ ")
    if key.startswith("hydra"):
        return []
    if key in _OTHERS_CALL_IT:
        return [_OTHERS_CALL_IT[key]]
    last = key.rpartition(".")[2]
    scores: dict[str, float] = {}
    for real in real_keys():
        names = ((key, real), (last, real.rpartition(".")[2]))
        scores[real] = max(difflib.SequenceMatcher(None, *pair).ratio() for pair in names)
    best = max(scores.values())
    found = [real for real, score in scores.items() if score == best] if best >= CLOSE else []
    found.sort(key=lambda real: -difflib.SequenceMatcher(None, key, real).ratio())
    return [real for real in found if "." not in real] or found[:_MOST]


def options_with(group: str, text: str = "") -> list[str]:
    """The options of a group whose YAML files have this text in them."""
    files = sorted((config_dir() / group).glob("*.yaml"))
    return [file.stem for file in files if text in file.read_text()]


@cache
def real_keys(only_group: str | None = None, only_option: str = "*") -> tuple[str, ...]:
    """All groups and keys, or those of one option, in the order of their names."""
    names = set() if only_group else {*PLAIN_KEYS, *TARGETS, "experiment"}
    if only_group is None:
        content = parse_yaml((config_dir() / "train.yaml").read_bytes())
        nodes = {key: value for key, value in content.items() if key not in ("defaults", "hydra")}
        names |= {name for key, value in nodes.items() for name in _leaves(key, value)}
    for file in (config_dir()).glob(f"{only_group or '*'}/{only_option}.yaml"):
        content, group = parse_yaml(file.read_bytes()) or {}, file.parent.name
        if "@package _global_" not in file.read_text():
            names |= {name for key in content for name in _leaves(f"{group}.{key}", content[key])}
        elif group != "experiment":
            names |= {name for name in _leaves(group, content[group])}
        for base in content.get("defaults", ()) if only_group else ():
            names |= set(real_keys(group, base)) if isinstance(base, str) and base != "_self_" else set()
    hidden = re.compile(r"(.*\.)?(_\w+_|defaults(\..*)?)")
    return tuple(sorted(name for name in names if not hidden.fullmatch(name)))


def shown_key(key: str) -> str:
    """A key as it is named in a sentence, cut if it is long."""
    return key if len(key) <= 80 else f"{key[:80]}..."


def _leaves(name: str, value: Any) -> list[str]:
    """The full names of a value's keys; its own where it has none."""
    if not isinstance(value, Mapping) or not value:
        return [name]
    return [leaf for key in value for leaf in _leaves(f"{name}.{key}", value[key])]
