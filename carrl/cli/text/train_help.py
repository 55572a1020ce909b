"""What `carrl train --help` prints."""

import re
import shutil
import textwrap
from itertools import takewhile
from pathlib import Path

from carrl.config import config_dir
from carrl.train.composition import options_with, real_keys

_HEAD = """usage: carrl train [GROUP=OPTION | KEY=VALUE]... [FLAG]...

Trains a policy and leaves a run's folder, outputs/DATE/TIME. With nothing else it is the paper's run."""
_FLAGS = """Flags:
  -m, --multirun            train with every combination of the values given, as in -m seed=0,1 loss=dqn,double_dqn
  -c, --cfg job|hydra|all   show the configuration; with --resolve resolved, with -p, --package KEY a part of it
  -i, --info                show how it is put together
  -cd, --config-dir FOLDER  of groups and experiments of your own
  --trust MODULE            with resume=RUN, where the run has parts of your own

resume=RUN goes on with a run, hydra.run.dir=FOLDER names the new one's folder.
docs/configuration.md explains every key; carrl --shell-completion bash|zsh|fish completes them."""
_MOST = 100


def print_help() -> None:
    """Prints experiments, groups with their options, keys and flags."""
    print(_HEAD)
    print("\nExperiments, such as experiment=fast:")
    for name in options_with("experiment"):
        _print_entry(name, _first_comment(config_dir() / "experiment" / f"{name}.yaml"))
    print("\nGroups and their options, such as loss=double_dqn:")
    groups = sorted(folder.name for folder in config_dir().iterdir() if folder.is_dir() and folder.name != "experiment")
    for group in groups:
        _print_entry(group, ", ".join(options_with(group)))
    print("\nKeys, such as trainer.frames=20000, besides those of the options:")
    keys = [key for key in real_keys() if key.partition(".")[0] not in (*groups, "experiment", "search")]
    keys = [key for key in keys if not any(other.startswith(f"{key}.") for other in keys)]
    print(textwrap.fill(", ".join(keys), _width(), initial_indent="  ", subsequent_indent="  "))
    print(f"\n{_FLAGS}")


def _first_comment(file: Path) -> str:
    """The first sentence of the comment at the head of a file."""
    comment = takewhile(lambda line: line.startswith("#"), file.read_text().splitlines()[1:])
    text = " ".join(line[2:] for line in comment)
    return re.split(r"(?<! al)\. ", text)[0].removesuffix(".")


def _print_entry(name: str, what: str) -> None:
    indent = " " * 18
    print(
        textwrap.fill(what, _width(), initial_indent=f"  {name:<15} ", subsequent_indent=indent, break_on_hyphens=False)
    )


def _width() -> int:
    return min(_MOST, shutil.get_terminal_size((_MOST, 24)).columns)
