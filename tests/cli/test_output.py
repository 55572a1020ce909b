"""Standard output that is full, closed or no longer read: one sentence or a quiet end, and the right exit code."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from carrl.cli.main import main
from carrl.cli.process import guarded_output
from tests.run_folders import write_run

FULL = Path("/dev/full")
NEEDS_FULL = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
IS_FULL = "carrl: standard output cannot be written: No space left on device; send it elsewhere\n"
CARRL = f'"{sys.executable}" -m carrl.cli.main'


def shell(command, cwd):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.getcwd(), os.environ.get("PYTHONPATH", "")])}
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=cwd, env=environment, timeout=120
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a run in it."""
    folder = tmp_path_factory.mktemp("output")
    write_run(folder / "run")
    return folder


VERBS = [
    "--help",
    "--version",
    "train --help",
    "train --cfg job",
    "report run",
    "report run --json",
    "track list --json",
    "track check oval",
]


@NEEDS_FULL
@pytest.mark.parametrize("verb", [verb.split() for verb in VERBS], ids=VERBS)
def test_a_full_standard_output_is_one_sentence(verb, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    with FULL.open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(verb) == 2
        monkeypatch.undo()
    assert capsys.readouterr().err == IS_FULL


@NEEDS_FULL
def test_python_adds_nothing_when_it_ends(folder):
    for command in ("track list", "report run --json", "train --help"):
        done = shell(f"{CARRL} {command} >/dev/full", folder)
        assert (done.returncode, done.stderr) == (2, IS_FULL), command


def test_a_closed_standard_output_is_one_sentence(folder):
    done = shell(f"{CARRL} track list >&-", folder)
    says = "carrl: standard output is closed; send it somewhere, such as >/dev/null\n"
    assert (done.returncode, done.stderr) == (2, says)


def test_a_run_is_refused_before_a_file_takes_the_place_of_a_closed_stream(folder):
    done = shell(f"{CARRL} train hydra.run.dir=never >&- 2>&- <&-; echo $?", folder)
    assert (done.stdout, (folder / "never").exists()) == ("2\n", False)


@pytest.mark.parametrize(
    ("verb", "code"), [("track list --json", 0), ("report run --json", 0), ("track check bad.csv", 2)]
)
def test_a_reader_that_has_gone_ends_it_quietly(verb, code, folder):
    done = shell(f"{{ sleep 0.2; {CARRL} {verb}; echo $? >&2; }} 2>errors | true; cat errors", folder)
    assert done.stdout.splitlines()[-1] == str(code)
    assert "Traceback" not in done.stdout and "Exception ignored" not in done.stdout
    assert len(done.stdout.splitlines()) == (1 if code == 0 else 2)


@NEEDS_FULL
def test_a_full_standard_error_keeps_nothing_from_going_on(folder):
    done = shell(f"{CARRL} track check nowhere oval 2>/dev/full", folder)
    assert done.returncode == 2
    assert "oval" in done.stdout


def test_both_streams_are_given_back(capsys):
    before = sys.stdout, sys.stderr
    with guarded_output():
        assert (sys.stdout, sys.stderr) != before
    assert (sys.stdout, sys.stderr) == before
