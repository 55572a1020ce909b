"""What is typed after `carrl train` and `carrl tune`: flags in any place, and overrides as Hydra can read them."""

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from carrl.errors import ConfigError, did_you_mean, shown
from carrl.train.composition import nearest_keys, no_such_option, options_with, quote

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override

SWITCHES = {"-h": "--help", "-m": "--multirun", "-r": "--run"}
TRUST = "--trust"
"""CarRL's own, with resume=: a module whose parts the run may name."""
VALUED = {"-c": "--cfg", "-p": "--package", "-cp": "--config-path", "-cn": "--config-name", "-cd": "--config-dir"}
_VALUED = (*VALUED.values(), TRUST)
CHOICES = {
    "--cfg": ("job", "hydra", "all"),
    "--info": ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath"),
}
FLAGS = ("--resolve", "--info", *SWITCHES.values(), *_VALUED)
"""Those that `carrl train` takes, each in any place."""
_CARRLS = ("--version",)
"""Those that every verb of `carrl` takes."""
_ALONE = ("--run", "--multirun", "--cfg", "--info")
_SHORT = {**SWITCHES, **VALUED, "-i": "--info"}
_WHOLE = ("hydra.run.dir", "hydra.sweep.dir")
"""Keys that have one path, which may have commas and equals signs in it."""
_FOLDERS = (*_WHOLE, "hydra.sweep.subdir")
_HYDRA_TAKES = re.compile(
    r"hydra\.((run\.dir|sweep\.(dir|subdir)|mode|verbose|output_subdir|searchpath|job\.(name|chdir|env_copy))$|"
    r"(job\.(env_set|config)|sweeper|launcher|callbacks|job_logging|hydra_logging)\.)"
)
"""What of Hydra's own may be added with +; it would take all else, too, and not read it."""
_IN_THE_SIMULATOR = re.compile(
    r"(exploration|evaluation|collector|recorder|start|env)(\.|$)|"
    r"trainer\.(frames|episodes|frames_per_update)$"
)
"""What a run that learns from logs does not read."""
_ITEM = re.compile(
    r"""\s*(?:'(?P<single>(?:\\.|[^'\\])*)'|"(?P<double>(?:\\.|[^"\\])*)"|(?P<plain>[^,]*?))\s*(?:,|$)"""
)


@dataclass(frozen=True)
class Arguments:
    """What was typed, sorted.

    Attributes:
        flags: by their long names, those with a value as --flag=value.
        overrides: all others.
    """

    flags: tuple[str, ...]
    overrides: tuple[str, ...]


def sort_arguments(argv: Sequence[str]) -> Arguments:
    """Tells flags from overrides, wherever they stand.

    Raises:
        ConfigError: there is no such flag, it lacks its value, or two do not go together.
    """
    flags, overrides, rest = [], [], list(argv)
    while rest:
        argument = rest.pop(0)
        if not argument.startswith("-"):
            overrides.append(argument)
            continue
        flag, equals, value = argument.partition("=")
        flag = _SHORT.get(flag, flag)
        if flag not in FLAGS or (equals and flag not in (*_VALUED, "--info")):
            raise ConfigError(_unknown_flag(argument, rest))
        if flag in _VALUED and not equals:
            if not rest:
                raise ConfigError(f"{flag} lacks its value; write {flag} {'|'.join(CHOICES.get(flag, ('VALUE',)))}")
            value = rest.pop(0)
        elif flag == "--info" and not equals:
            value = rest.pop(0) if rest and rest[0] in CHOICES[flag] else "all"
        if flag in CHOICES and value not in CHOICES[flag]:
            raise ConfigError(f"{flag} is '{value}'; choose one of: {', '.join(CHOICES[flag])}")
        flags.append(f"{flag}={value}" if value else flag)
    _check_flags(flags)
    return Arguments(tuple(flags), tuple(overrides))


def _unknown_flag(argument: str, rest: Sequence[str]) -> str:
    flag, equals, value = argument.partition("=")
    key = flag.lstrip("-").replace("-", "_")
    keys = nearest_keys(key)
    close = did_you_mean(flag, (*FLAGS, *_CARRLS))
    if close and key not in {each.rpartition(".")[2] for each in keys}:
        return f"carrl train has no flag {flag}{close}"
    if not equals:
        value = rest[0] if rest and "=" not in rest[0] and not rest[0].startswith("-") else "VALUE"
    return f"carrl train has no flag {flag}; write {(keys or [key or 'KEY'])[0]}={value}"


def _check_flags(flags: Sequence[str]) -> None:
    names = [flag.partition("=")[0] for flag in flags]
    alone = [name for name in _ALONE if name in names]
    if len(alone) > 1:
        raise ConfigError(f"{alone[0]} and {alone[1]} do not go together; give one of them")
    for flag, other in (("--resolve", "--cfg"), ("--package", "--cfg")):
        if flag in names and other not in names and "--help" not in names:
            raise ConfigError(f"{flag} has no effect without {other}; add {other} job, or leave {flag} out")


def readable_overrides(
    overrides: Sequence[str], is_sweep: bool | None, verb: str = "carrl tune", folder_key: str = "--folder"
) -> list[str]:
    """The overrides with their paths absolute and quoted where Hydra would misread them, each sure to be read.

    Args:
        overrides: as typed.
        is_sweep: whether there may be several values; None where there is nothing of Hydra's to set up either.
        verb: what has nothing of Hydra's, for messages.
        folder_key: how that names its folder.

    Raises:
        ConfigError: one cannot be read, or has no effect on what is run.
    """
    named = named_overrides(overrides)
    for parsed in map(_parsed, named):
        if is_sweep is None and re.match(r"hydra[./]", parsed.key_or_group):
            raise ConfigError(
                f"{parsed.input_line} has no effect on {verb}; leave it out ({folder_key} names the "
                f"{'study' if verb == 'carrl tune' else 'run'}'s folder)"
            )
        _check_effect(parsed, is_sweep, searches=verb == "carrl tune")
        _check_folder(parsed)
        _check_option(parsed)
    return named


def named_overrides(overrides: Sequence[str]) -> list[str]:
    """The overrides as `name_files` writes them.

    Raises:
        ConfigError: one cannot be read.
    """
    named = [named for override in overrides for named in name_files(override)]
    for override in named:
        _parsed(override)
    return named


def _check_effect(override: "Override", is_sweep: bool | None, searches: bool) -> None:
    """Raises ConfigError for what only a sweep, or only a single run, would heed."""
    key, typed = override.key_or_group, str(override.input_line)
    if not (is_sweep is None and searches) and is_search(typed) and not override.is_delete():
        raise ConfigError(f"{typed} has no effect on carrl train; carrl tune searches")
    is_added = override.is_add() or override.is_force_add()
    if is_added and key.startswith("hydra.") and not _HYDRA_TAKES.match(key):
        raise ConfigError(f"there is no key {key}; carrl train --cfg hydra shows all there are")
    if is_sweep and key.startswith("hydra.run."):
        raise ConfigError(f"{typed} has no effect on a sweep; write hydra.sweep.dir=, or leave -m out")
    if not is_sweep and re.match(r"hydra(\.sweep\.|[./]sweeper|[./]launcher)", key):
        raise ConfigError(f"{typed} has no effect on a single run; add -m, or write hydra.run.dir= for its folder")
    if not is_sweep and override.is_sweep_override():
        remedy = "choose one" if is_sweep is None else "add -m to train with each"
        several = "trainer.seeds" if key == "seed" else key
        raise ConfigError(f"{typed} has several values; {remedy}, or write a list as {several}=[A,B]")


def check_is_read(overrides: Sequence[str], config: Mapping[str, Any]) -> None:
    """Raises ConfigError for an override of what a run with this configuration does not read, though others do.

    Args:
        overrides: as Hydra reads them, without flags; one that has several values counts for nothing here.
        config: what the run, or the first of a sweep, is made from.
    """
    parsed = [_parsed(override) for override in overrides]
    varying = {each.key_or_group for each in parsed if each.is_sweep_override()}
    learns_from_logs = config.get("data") and not varying & {"data", "experiment"}
    has_seeds = config["trainer"].get("seeds") is not None and not varying & {"trainer.seeds", "experiment"}
    for each in parsed:
        if learns_from_logs and _IN_THE_SIMULATOR.match(each.key_or_group) and not _leaves_out_log(each):
            raise ConfigError(
                f"{each.input_line} has no effect with data=log, which learns without the simulator, for data.updates; "
                "leave it out"
            )
        if has_seeds and each.key_or_group == "seed":
            raise ConfigError(
                f"{each.input_line} has no effect beside trainer.seeds={shown(config['trainer']['seeds'])}, "
                "which names the seed of every replicate; leave one of them out"
            )


def _leaves_out_log(override: "Override") -> bool:
    return override.key_or_group == "recorder" and (override.is_delete() or override.value() is None)


def is_search(override: str) -> bool:
    """Whether an override is of what `carrl tune` searches."""
    return re.match(r"[+~]*search([.=]|$)", override) is not None


def _check_folder(override: "Override") -> None:
    """Raises ConfigError for a folder without a name, as of a variable that is not set: Hydra would take this one."""
    key, value = override.key_or_group, override.value()
    if key in _FOLDERS and not override.is_delete() and not str(getattr(value, "text", value) or "").strip():
        raise ConfigError(f"{key}= lacks its value; write {key}=FOLDER, or leave it out")


def _check_option(override: "Override") -> None:
    """Raises ConfigError for a number or null in the place of a group's option, where Hydra ends with a traceback."""
    group, options = override.key_or_group, options_with(override.key_or_group)
    for value in getattr(override.value(), "list", [override.value()]):
        if options and not override.is_delete() and isinstance(value, int | float | dict | None):
            raise ConfigError(no_such_option(group, "null" if value is None else str(value), options))


def _parsed(text: str) -> "Override":
    """The override.

    Raises:
        ConfigError: it cannot be read; the message shows what can.
    """
    try:
        override = OverridesParser.create().parse_override(text)
    except HydraException as error:
        raise ConfigError(_unreadable(text, error)) from error
    if not override.key_or_group:
        raise ConfigError(f"'{text}' has no key; write KEY=VALUE, such as seed=3")
    return override


def _unreadable(text: str, error: HydraException) -> str:
    key, equals, value = text.partition("=")
    if not equals:
        close = nearest_keys(key.lstrip("+~"))
        return f"'{text}' is no override; write {close[0] if close else 'KEY'}=VALUE, or ~KEY to leave one out"
    if "while evaluating" in str(error):
        return f"'{text}' cannot be read: {' '.join(str(error).partition('while evaluating ')[2].split())}"
    if not _is_readable(f"{key}='x'"):
        return f"'{text}' cannot be read: '{key}' is no key; write KEY=VALUE, such as seed=3"
    return f"'{text}' cannot be read; close brackets and quotes, or quote the value: {_for_shell(key, value)}"


def _for_shell(key: str, value: str) -> str:
    """The override with its value quoted for Hydra, and the whole for the shell."""
    quoted = f"{key}={quote(value)}"
    return shlex.quote(quoted) if re.search(r"[$`\"!\\]", quoted) else f'"{quoted}"'


def _is_readable(text: str) -> bool:
    try:
        OverridesParser.create().parse_override(text)
    except HydraException:
        return False
    return True


def is_text(text: str) -> bool:
    """Whether Hydra reads the override's value as one text."""
    return _is_readable(text) and isinstance(OverridesParser.create().parse_override(text).value(), str)


def unquote(value: str) -> str:
    """The value without the quotes around it, if it has any."""
    found = _ITEM.fullmatch(value)
    return value if found is None or found["plain"] is not None else _text_of(found)


def name_files(argument: str) -> list[str]:
    """Makes paths of files absolute and quotes them, as Hydra reads a path such as `seed=0/train.mcap` only quoted.

    `track=FILE` stands for the track group's option `file`; FILE,FILE sweeps. `data.path=[FILE,FILE]` is a list. A path
    that is there is taken whole, whatever commas are in it.
    """
    key, equals, value = argument.partition("=")
    bare = key.lstrip("+")
    if not equals or not value:
        return [argument]
    if bare == "track" and any("." in path or os.sep in path or _in_library(path) for path in _paths_in(value)):
        return [f"{key}=file", f"track.name_or_path={','.join(map(_track_or_path, _paths_in(value)))}"]
    if bare in ("track.folder", "opponents.run", "opponents.line") and value not in ("null", "???"):
        return [f"{key}={_quote_paths(value)}"]
    if bare == "data.path" and value not in ("???", "[]"):
        is_list = value.startswith("[") and value.endswith("]") and not os.path.exists(value)
        return [f"{key}=[{_quote_paths(value[1:-1])}]" if is_list else f"{key}={_quote_paths(value)}"]
    if (bare in _WHOLE and not is_text(argument)) or (os.path.exists(value) and not _is_readable(argument)):
        return [f"{key}={quote(unquote(value))}"]
    return [argument]


def _track_or_path(value: str) -> str:
    """A track as `track.name_or_path` takes it: the path of a file, or a name such as oval.

    Raises:
        ConfigError: it is an option of the track group that is neither.
    """
    if "." in value or os.sep in value or _in_library(value):
        return quote(os.path.abspath(_in_library(value) or value))
    if value in options_with("track") and value not in options_with("track", f"name_or_path: {value}"):
        raise ConfigError(f"track={value} does not go with files in one sweep; run a sweep of its own for it")
    return value


def _in_library(name: str) -> str | None:
    """The path of the file of this name in the folders of `CARRL_TRACKS`; built-in tracks come first."""
    if not os.environ.get("CARRL_TRACKS") or name in options_with("track"):
        return None
    from carrl.tracks.library import find_file  # Here, since it imports all formats.

    path = find_file(name)
    return None if path is None else str(path)


def _quote_paths(value: str) -> str:
    return ",".join(quote(os.path.abspath(path)) for path in _paths_in(value))


def _paths_in(value: str) -> list[str]:
    """The paths between the commas: those in quotes, the longest that are there, and the rest one by one."""
    if os.path.exists(value):
        return [value]
    found = [each for each in _ITEM.finditer(value) if each.start() < len(value)]
    paths: list[str] = []
    while found:
        count = next((n for n in range(len(found), 1, -1) if os.path.exists(_joined(found[:n]))), 1)
        paths.append(_joined(found[:count]) if count > 1 else _text_of(found[0]))
        del found[:count]
    return paths


def _joined(items: Sequence["re.Match[str]"]) -> str:
    return "".join(each[0] for each in items).removesuffix(",").strip()


def _text_of(item: "re.Match[str]") -> str:
    if item["plain"] is not None:
        return item["plain"]
    return re.sub(r"\\(['\"\\])", r"\1", item["single"] if item["single"] is not None else item["double"])
