"""Completion in the shell: the script that it evaluates, and the words that may stand where the cursor is.

The words of `carrl train` and `carrl tune` come from Hydra's own completion, the others from `FLAGS`.
"""

from collections.abc import Sequence

from carrl.errors import ConfigError
from carrl.train import overrides

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
    "train": overrides.FLAGS,
    "tune": ("--trials", "--timeout", "--objective", "--no-pruning", "--folder", "--config-dir", "--storage"),
    "evaluate": (
        *("--track", "--starts", "--laps", "--limit", "--speed-trace"),
        *("--policy", "--checkpoint", "--trust", "--json"),
    ),
    "laps": (*_READING, "--out", "--json"),
    "export": ("--format", "--out", "--seed", "--checkpoint", "--trust"),
    "drive": ("--track", "--run", "--vehicle", "--fps", "--trust"),
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
}
"""Of each verb, in full; a test compares them with the verbs' own. Here, since some verbs take seconds to import."""

BASH = r"""_carrl_completion() {
    local line="${COMP_LINE:0:COMP_POINT}" IFS=$'\n'
    local word="${line##* }"
    COMPREPLY=($(command carrl --complete "$line" 2>/dev/null))
    case "$COMP_WORDBREAKS" in
        *=*) COMPREPLY=("${COMPREPLY[@]#"${word%"${word##*[=:]}"}"}") ;;  # bash replaces what follows the last of these
    esac
}
complete -o nospace -o default -F _carrl_completion carrl"""
SCRIPTS = {"bash": BASH, "zsh": f"autoload -U +X compinit bashcompinit && compinit && bashcompinit\n{BASH}"}


def print_script(arguments: Sequence[str]) -> int:
    """Prints what the shell is to evaluate: eval "$(carrl --shell-completion bash)".

    Raises:
        ConfigError: the shell is not named, or not one of those.
    """
    if len(arguments) != 1 or arguments[0] not in SCRIPTS:
        raise ConfigError('--shell-completion takes bash or zsh: eval "$(carrl --shell-completion bash)"')
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
        return [f"{flag} " for flag in (*FLAGS[verb], "--help") if flag.startswith(word)]
    return _overrides(before[1:], word) if verb in ("train", "tune") else []


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
