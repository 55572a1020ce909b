"""What a log says of the run that wrote it."""

import json
import subprocess
from importlib.metadata import version

import pytest

import carrl
from carrl.data.description import describe_run, git_commit


def test_the_entries_name_seed_track_and_packages():
    entries = describe_run(carrl.TrackEnv("oval", num_envs=3, seed=0).task, seed=5, cars=3)
    assert (entries["seed"], entries["track"], entries["num_envs"]) == ("5", "oval", "3")
    packages = json.loads(entries["packages"])
    assert packages["torch"] == version("torch")
    assert packages["carrl"] == carrl.__version__
    assert all(isinstance(value, str) for value in entries.values())


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository of one commit that CarRL seems to run from."""
    package = tmp_path / "carrl" / "__init__.py"
    package.parent.mkdir()
    package.write_text("")
    monkeypatch.setattr(carrl, "__file__", str(package))

    def git(*arguments):
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True)

    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    return package


def test_the_commit_is_that_of_the_checkout_and_says_whether_files_differ(checkout):
    commit = git_commit()
    assert commit and len(commit) == 40
    checkout.write_text("# changed\n")
    assert git_commit() == f"{commit}-dirty"


def test_without_a_repository_there_is_no_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(carrl, "__file__", str(tmp_path / "carrl" / "__init__.py"))
    assert git_commit() is None


def test_without_git_there_is_no_commit(checkout, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert git_commit() is None
