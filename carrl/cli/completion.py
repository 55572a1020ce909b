"""Completion in the shell: the script that it evaluates, and the words that may stand where the cursor is.

The words of `carrl train` and `carrl tune` come from Hydra's own completion, the others from `FLAGS` and `VALUES`, and
those of runs from the folders that are there.
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import get_args

from carrl.cli.export import FORMATS
from carrl.errors import ConfigError
from carrl.evaluation.asked import PolicyName
from carrl.tracks.names import BUILT_IN
from carrl.train.files import CONFIG, LOG
from carrl.train.sweep import JOB

_SELECTION = ("--episode", "--env", "--begin", "--end")
_RANDOM = (
    "--seed",
    "--count",
    "--corner-radius",
    "--width",
    "--length",
    "--corner-spacing",
    "--widening",
    "--hairpins",
)
_READING = ("--scale", "--width", "--walls", "--circuit", "--direction")
FLAGS = {
    "train": (
        *("--resolve", "--info", "--help", "--multirun", "--run"),
        *("--cfg", "--package", "--config-path", "--config-name", "--config-dir", "--trust"),
    ),
    "tune": ("--trials", "--timeout", "--objective", "--no-pruning", "--folder", "--config-dir", "--storage"),
    "evaluate": (
        *("--track", "--starts", "--laps", "--limit", "--speed-trace", "--log", "--png", "--video"),
        *("--policy", "--checkpoint", "--trust", "--json"),
    ),
    "race": ("--track", "--laps", "--races", "--opponents", "--pace", "--cars", "--log", "--trust", "--json"),
    "watch": ("--track", "--live", "--out", "--fps", "--trust"),
    "laps": (*_READING, "--out", "--json"),
    "export": ("--format", "--out", "--seed", "--checkpoint", "--trust"),
    "drive": ("--track", "--run", "--vehicle", "--opponents", "--cars", "--fps", "--trust"),
    "report": ("--out", "--json", "--baseline", "--curves", "--best-lap", "--bin-size", "--trust"),
    "track list": ("--json",),
    "track show": ("--out", *_READING),
    "track check": ("--json", "--body-radius", "--turn-radius", "--step-length", "--near-wall", *_READING),
    "track convert": ("--resolution", "--force", *_READING),
    "track lap-time": (
        *("--json", "--quick", "--spacing", "--margin", "--check", "--png", "--csv", "--force"),
        *_READING,
    ),
    "track random": (*_RANDOM, "--out", "--force", "--json"),
    "log info": ("--json",),
    "log ls": ("--sort", "--reverse", "--crashed", "--lapped", "--env", "--limit", "--json"),
    "log show": ("--episode", "--steps", "--all", "--json"),
    "log stats": ("--png", "--json"),
    "log cat": ("--topic", *_SELECTION, "--limit", "--json"),
    "log check": ("--json",),
    "log recover": ("--run", "--json"),
    "log export": _SELECTION,
    "log replay": ("--episode", "--output", "--no-open", "--rerun"),
    "doctor": ("--json",),
}
"""Of each verb, in full; a test compares them with the verbs' own. Here, since some verbs take seconds to import."""

VALUES = {
    "--track": BUILT_IN,
    "--policy": get_args(PolicyName),
    "--checkpoint": ("best", "last"),
    "--format": FORMATS,
    "--objective": ("first_lap", "drive", "lap_time"),
    "--vehicle": ("bicycle", "kinematic", "paper", "single_track"),
    "--opponents": ("line", "rule"),
    "--direction": ("clockwise", "counterclockwise"),
}
"""Of flags, in full, but for files of one's own."""
_TAKE_RUNS = ("evaluate", "export", "race", "report", "watch")
_TAKE_TRACKS = ("laps", "track show", "track check", "track convert", "track lap-time")
RESUME, OPPONENTS = "resume=", "opponents.run="
OUTPUTS = Path("outputs")
"""Where runs are looked for, unless another folder is begun."""
_DEPTH, _MOST_FOLDERS, _MOST_RUNS = 4, 5000, 50

BASH = r"""_carrl_completion() {
    local line="${COMP_LINE:0:COMP_POINT}" IFS=$'\n'
    local word="${line##* }"
    COMPREPLY=($(command carrl --complete "$line" 2>/dev/null))
    case "$COMP_WORDBREAKS" in
        *=*) COMPREPLY=("${COMPREPLY[@]#"${word%"${word##*[=:]}"}"}") ;;  # bash replaces what follows the last of these
    esac
}
complete -o nospace -o default -F _carrl_completion carrl"""
ZSH = r"""(( $+functions[compdef] )) || { autoload -U compinit && compinit }
_carrl() {
    local -a found
    found=("${(@f)$(command carrl --complete "${(j: :)words[1,CURRENT-1]} $PREFIX" 2>/dev/null)}")
    found=(${found:#})
    if (( $#found )); then compadd -Q -V carrl -S '' -- $found; else _files; fi
}
compdef _carrl carrl"""
FISH = r"""function __carrl_complete
    set -l found (command carrl --complete (commandline -cp | string collect) 2>/dev/null)
    if set -q found[1]
        string trim --right -- $found
    else
        __fish_complete_path (commandline -ct)
    end
end
complete -c carrl -f -k -a '(__carrl_complete)'"""
SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}


def print_script(arguments: Sequence[str]) -> int:
    """Prints what the shell is to evaluate: eval "$(carrl --shell-completion bash)"; fish sources it.

    Raises:
        ConfigError: the shell is not named, or not one of those.
    """
    if len(arguments) != 1 or arguments[0] not in SCRIPTS:
        raise ConfigError(
            '--shell-completion takes bash, zsh or fish: eval "$(carrl --shell-completion bash)"; '
            "carrl --shell-completion fish | source"
        )
    print(SCRIPTS[arguments[0]])
    return 0


def complete(arguments: Sequence[str]) -> int:
    """Prints the words that may stand at the end of a line, one a line; of files the shell knows more."""
    for word in candidates(arguments[0] if arguments else ""):
        print(word)
    return 0


def candidates(line: str) -> list[str]:
    """The words, with a blank behind those that are whole.

    Args:
        line: what is typed up to the cursor, `carrl` included.
    """
    *before, word = _words(line)[1:] or [""]
    verbs = [] if word.startswith("-") else _verbs_after(before)
    if verbs or not before:
        names = (*verbs, *(() if before else ("--help", "--version", "--shell-completion")))
        return [f"{name} " for name in names if name.startswith(word)]
    verb = next((verb for verb in (" ".join(before[:2]), before[0]) if verb in FLAGS), None)
    if verb is None:
        return []
    if word.startswith("-"):
        return [f"{flag} " for flag in dict.fromkeys((*FLAGS[verb], "--help")) if flag.startswith(word)]
    if before[-1] in VALUES and before[-1] in FLAGS[verb]:
        return [f"{value} " for value in VALUES[before[-1]] if value.startswith(word)]
    for key in (RESUME, OPPONENTS):
        if word.startswith(key):
            return [f"{key}{run} " for run in _runs(word.removeprefix(key))]
    if verb in _TAKE_RUNS or before[-1] == "--run":
        return [f"{run} " for run in _runs(word, sweeps=verb in _TAKE_RUNS)]
    if verb in _TAKE_TRACKS and word:
        return [f"{name} " for name in BUILT_IN if name.startswith(word)]
    if before[0] == "log" and not before[-1].startswith("-"):
        return [f"{log} " for log in _logs(word)]
    return _overrides(before[1:], word) if verb in ("train", "tune") else []


def _logs(word: str) -> list[str]:
    """The logs of runs whose paths begin with the word."""
    logs = [f"{run}{os.sep}{LOG}" for run in _runs(word if word.count(os.sep) < 2 else os.path.dirname(word))]
    return [log for log in logs if log.startswith(word) and os.path.isfile(log)]


def _runs(word: str, sweeps: bool = False) -> list[str]:
    """The folders of runs, and on demand of sweeps of them, that begin with the word, the newest first."""
    root = os.path.dirname(word) if os.sep in word else str(OUTPUTS)
    found = [path for path in _runs_below(root, sweeps) if path.startswith(word)]
    return sorted(found, key=os.path.getmtime, reverse=True)[:_MOST_RUNS]


def _runs_below(root: str, sweeps: bool) -> Iterator[str]:
    """Folders that hold a run's configuration, below none that does, and those whose folders hold a sweep's notes."""
    for seen, (path, folders, _) in enumerate(os.walk(root)):
        if os.path.isfile(os.path.join(path, CONFIG)):
            yield path
            folders.clear()
        elif seen > _MOST_FOLDERS or os.path.relpath(path, root).count(os.sep) >= _DEPTH:
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if sweeps and any(os.path.isfile(os.path.join(path, name, JOB)) for name in folders):
            yield path


def _verbs_after(before: Sequence[str]) -> list[str]:
    """The verbs that may follow these words."""
    verbs = [verb.split() for verb in FLAGS]
    return sorted({verb[len(before)] for verb in verbs if verb[: len(before)] == [*before] != verb})


def _words(line: str) -> list[str]:
    """The words of the line, the last of which may be empty."""
    words = line.split()
    return words if line and not line[-1].isspace() else [*words, ""]


def _overrides(before: Sequence[str], word: str) -> list[str]:
    """Hydra's completions of an override, given those before it; its own settings only where they are asked for."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.plugins.completion_plugin import DefaultCompletionPlugin

    from carrl.config import config_dir

    typed = [each for each in before if "=" in each and not each.startswith("-")]
    with initialize_config_dir(str(config_dir()), version_base="1.3"):
        plugin = DefaultCompletionPlugin(GlobalHydra.instance().config_loader())
        found = plugin._query(config_name="train", line=" ".join([*typed, word]) + ("" if word else " "))
    hidden = () if word.startswith("hydra") else ("hydra",)
    return [each for each in found if not each.startswith(hidden) and "._" not in each]
