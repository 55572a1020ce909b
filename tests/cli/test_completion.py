"""Completion in a real bash, and the words that it offers."""

import argparse
import importlib
import os
import re
import shutil
import subprocess
import sys

import pytest

from carrl.cli import export
from carrl.cli.completion import FLAGS, VALUES, candidates
from carrl.cli.main import main
from carrl.export.policy import FORMATS
from carrl.tracks.drawing_file import DRAWINGS
from carrl.train import overrides
from carrl.train.composition import options_with
from carrl.train.objectives import OBJECTIVES


def flags_of(verb, parser):
    """The long flags of every verb of a parser, as `FLAGS` has them."""
    groups = [each for each in parser._actions if isinstance(each, argparse._SubParsersAction)]
    if groups:
        return {
            name: flags
            for own, each in groups[0].choices.items()
            for name, flags in flags_of(f"{verb} {own}", each).items()
        }
    long = {flag for action in parser._actions for flag in action.option_strings if flag.startswith("--")}
    return {verb: long - {"--help"}}


def test_every_flag_and_value_is_what_there_is():
    assert set(FLAGS["train"]) == set(overrides.FLAGS)
    assert VALUES["--objective"] == tuple(OBJECTIVES)
    assert list(VALUES["--vehicle"]) == options_with("vehicle")
    assert VALUES["--track"] == tuple(DRAWINGS)
    assert tuple(FORMATS) == export.FORMATS


@pytest.mark.parametrize(
    "verb", ["tune", "evaluate", "race", "laps", "export", "drive", "report", "log", "track", "doctor"]
)
def test_every_flag_of_a_verb_is_offered(verb):
    expected = flags_of(verb, importlib.import_module(f"carrl.cli.{verb}")._parser())
    assert {name: set(flags) for name, flags in FLAGS.items() if name.split()[0] == verb} == expected


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("carrl tr", ["track ", "train "]),
        ("carrl --v", ["--version "]),
        ("carrl log s", ["show ", "stats "]),
        ("carrl log show --st", ["--steps "]),
        ("carrl train --m", ["--multirun "]),
        ("carrl train seed=1 loss=do", ["loss=double_dqn"]),
        ("carrl train -m optimizer.l", ["optimizer.lr="]),
        ("carrl train loss=cql loss.al", ["loss.alpha="]),
        ("carrl train loss=dqn loss.al", []),
        ("carrl tune --trials 3 experiment=tu", ["experiment=tune"]),
        ("carrl train hydra.swe", ["hydra.sweep.", "hydra.sweeper."]),
        ("carrl track check f", []),  # files, of which the shell knows
        ("carrl track check s", ["serpentine "]),
        ("carrl evaluate --policy r", ["rule ", "random "]),
        ("carrl do", ["doctor "]),
        ("carrl fly --", []),
    ],
)
def test_what_is_begun_is_completed(line, words):
    assert candidates(line) == words


def test_hydras_own_groups_are_not_offered_where_nothing_is_begun():
    assert candidates("carrl train ")
    assert "hydra" not in " ".join(candidates("carrl train "))


@pytest.fixture
def outputs(tmp_path, monkeypatch):
    """A folder with a run, which has a log, and a sweep of one run."""
    for run in ("outputs/2026-01-01/12-00-00", "outputs/multirun/2026-01-02/13-00-00/loss=dqn"):
        (tmp_path / run / ".hydra").mkdir(parents=True)
        (tmp_path / run / ".hydra" / "config.yaml").touch()
        (tmp_path / run / ("job.json" if "multirun" in run else "train.mcap")).touch()
    (tmp_path / "outputs" / "tune").mkdir()
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("carrl evaluate outputs/2", ["outputs/2026-01-01/12-00-00 "]),
        ("carrl evaluate outputs/t", []),
        ("carrl report outputs/m", [f"outputs/multirun/2026-01-02/13-00-00{end} " for end in ("", "/loss=dqn")]),
        ("carrl drive --run outputs/m", ["outputs/multirun/2026-01-02/13-00-00/loss=dqn "]),
        ("carrl train resume=outputs/2", ["resume=outputs/2026-01-01/12-00-00 "]),
        ("carrl log show ", ["outputs/2026-01-01/12-00-00/train.mcap "]),
        ("carrl log show outputs/2026-01-01/12-00-00/tr", ["outputs/2026-01-01/12-00-00/train.mcap "]),
        ("carrl log show --episode ", []),
    ],
)
def test_folders_of_runs_are_completed(outputs, line, words):
    assert sorted(candidates(line)) == words


def test_all_runs_are_offered_where_none_is_begun(outputs):
    assert len(candidates("carrl evaluate ")) == 3
    assert len(candidates("carrl train resume=")) == 2


@pytest.fixture
def environment(tmp_path):
    """One in which `carrl` is on the path."""
    command = tmp_path / "bin" / "carrl"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m carrl.cli.main "$@"\n')
    command.chmod(0o755)
    python_path = os.pathsep.join(path for path in (os.getcwd(), os.environ.get("PYTHONPATH")) if path)
    path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": python_path, "HOME": str(tmp_path), "TERM": "dumb"}


def bash(line, environment):
    """What a real bash offers for a line once the printed script is evaluated."""
    script = """
eval "$(carrl --shell-completion bash)"
COMP_LINE="$1" COMP_POINT=${#1}
"$(complete -p carrl | sed 's/.*-F \\([a-z_]*\\) .*/\\1/')"
printf '%s\\n' "${COMPREPLY[@]}"
"""
    return lines_of(["bash", "--norc", "-c", script, "bash", line], environment)


def fish(line, environment):
    """What a real fish offers; it adds blanks itself."""
    script = 'carrl --shell-completion fish | source; complete -C "$argv[1]"'
    return [
        f"{word} " if word[-1] not in "=." else word
        for word in lines_of(["fish", "-N", "-c", script, line], environment)
    ]


def zsh(line, environment):
    """What a real zsh makes of the line on Tab."""
    script = """
zmodload zsh/zpty
zpty shell zsh -f -i
zpty -w shell 'PS1=; eval "$(carrl --shell-completion zsh)"'
zpty -w shell 'note() { zle expand-or-complete; print -r -- "<<$BUFFER>>"; exit }'
zpty -w shell 'zle -N note; bindkey "^I" note; print READY'
zpty -r shell seen '*READY?[^"]*'
zpty -n -w shell "$1"$'\\t'
zpty -r shell seen '*<<*>>*' && print -r -- "${${seen##*<<}%%>>*}"
"""
    return lines_of(["zsh", "-f", "-c", script, "zsh", line], environment)


def lines_of(command, environment):
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is absent")
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.stderr == ""
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("carrl tra", ["track ", "train "]),
        ("carrl log show --st", ["--steps "]),
        ("carrl train seed=1 loss=do", ["double_dqn"]),  # bash replaces what follows the equals sign
    ],
)
def test_a_real_bash_completes(environment, line, words):
    assert bash(line, environment) == words


@pytest.mark.parametrize(
    ("line", "words"), [("carrl log show --st", ["--steps "]), ("carrl train seed=1 loss=do", ["loss=double_dqn "])]
)
def test_a_real_fish_completes(environment, line, words):
    assert fish(line, environment) == words


@pytest.mark.parametrize(
    ("line", "whole"),
    [
        ("carrl log show --st", "carrl log show --steps "),
        ("carrl train seed=1 loss=do", "carrl train seed=1 loss=double_dqn"),
    ],
)
def test_a_real_zsh_completes(environment, line, whole):
    assert zsh(line, environment) == [whole]


def test_only_shells_that_are_known_are_completed(capsys):
    assert main(["--shell-completion", "tcsh"]) == 2
    assert capsys.readouterr().err == (
        'carrl: --shell-completion takes bash, zsh or fish: eval "$(carrl --shell-completion bash)"; '
        "carrl --shell-completion fish | source\n"
    )


@pytest.mark.parametrize(
    "arguments", [["--version"], ["train", "--version"], ["train", "seed=1", "--version"], ["log", "--version"]]
)
def test_the_version_is_carrls(arguments, capsys):
    assert main(arguments) == 0
    import carrl

    assert capsys.readouterr().out == f"carrl {carrl.__version__}\n"


def test_the_help_of_train_names_only_flags_that_there_are(capsys):
    assert main(["train", "--help"]) == 0
    printed = capsys.readouterr().out
    assert "carrl --shell-completion bash" in printed
    assert set(re.findall(r"--[a-z][a-z-]+", printed)) <= {*overrides.FLAGS, "--shell-completion"}
