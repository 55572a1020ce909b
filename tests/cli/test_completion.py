"""Completion in a real bash, and the words that it offers."""

import argparse
import importlib
import os
import shutil
import subprocess
import sys

import pytest

from carrl.cli.completion import FLAGS, candidates
from carrl.cli.main import main


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


@pytest.mark.parametrize("verb", ["tune", "evaluate", "laps", "export", "drive", "report", "log", "track"])
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
        ("carrl evaluate outputs/", []),  # files, of which the shell knows
        ("carrl fly --", []),
        ("", []),
    ],
)
def test_what_is_begun_is_completed(line, words):
    if line:
        assert candidates(line) == words
    assert "hydra" not in " ".join(candidates("carrl train "))


@pytest.fixture
def bash(tmp_path):
    """What a real bash offers for a line, with `carrl` on its path and the printed script evaluated."""
    if shutil.which("bash") is None:
        pytest.skip("bash is absent")
    command = tmp_path / "carrl"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m carrl.cli.main "$@"\n')
    command.chmod(0o755)
    script = """
eval "$(carrl --shell-completion bash)"
COMP_LINE="$1" COMP_POINT=${#1}
complete -p carrl | sed 's/.*-F \\([a-z_]*\\) .*/\\1/' > function
"$(cat function)"
printf '%s\\n' "${COMPREPLY[@]}"
"""
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    environment["PYTHONPATH"] = os.pathsep.join(path for path in (os.getcwd(), os.environ.get("PYTHONPATH")) if path)

    def offers(line):
        command = ["bash", "--norc", "-c", script, "bash", line]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=60)
        assert done.stderr == ""
        return done.stdout.splitlines()

    return offers


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("carrl tra", ["track ", "train "]),
        ("carrl log show --st", ["--steps "]),
        ("carrl train seed=1 loss=do", ["double_dqn"]),  # bash replaces what follows the equals sign
    ],
)
def test_a_real_bash_completes(bash, line, words):
    assert bash(line) == words


def test_only_shells_that_are_known_are_completed(capsys):
    assert main(["--shell-completion", "fish"]) == 2
    assert capsys.readouterr().err == (
        'carrl: --shell-completion takes bash or zsh: eval "$(carrl --shell-completion bash)"\n'
    )


@pytest.mark.parametrize(
    "arguments", [["--version"], ["train", "--version"], ["train", "seed=1", "--version"], ["log", "--version"]]
)
def test_the_version_is_carrls(arguments, capsys):
    assert main(arguments) == 0
    import carrl

    assert capsys.readouterr().out == f"carrl {carrl.__version__}\n"


def test_the_help_of_train_names_only_flags_that_there_are(capsys):
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    printed = capsys.readouterr().out
    assert "carrl --shell-completion bash" in printed
    assert "--hydra-help" not in printed
