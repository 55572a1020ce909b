"""`carrl log replay`: where the page goes, what is opened."""

import os
from pathlib import Path

import pytest

from carrl.cli.main import main
from tests.cli.log.conftest import write_log


@pytest.fixture
def opened(monkeypatch):
    """What was opened in the browser; there is one."""
    addresses = []
    monkeypatch.setattr("webbrowser.open", lambda address: [addresses.append(address), True][1])
    return addresses


@pytest.fixture
def log(tmp_path):
    return write_log(tmp_path / "train.mcap")


def test_the_best_episode_opens_in_the_browser_from_beside_the_log(run, log, opened):
    page = log.with_name("episode-2.html")
    assert run("replay", log) == f"{page}\n"
    assert opened == [page.as_uri()]
    assert "episode 2" in page.read_text()


def test_without_opening_it_only_writes(run, log, opened, tmp_path):
    page = tmp_path / "my page.html"
    assert run("replay", log, "--episode", "1", "--output", page, "--no-open") == f"{page}\n"
    assert page.stat().st_size > 10_000
    assert opened == []
    assert not log.with_name("episode-1.html").exists()


def test_a_read_only_folder_makes_way_for_a_temporary_one(run, log, opened, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: path != log.parent)
    page = Path(run("replay", log, "--no-open").strip())
    assert page.name == "episode-2.html"
    assert page.parent != log.parent
    assert os.listdir(log.parent) == ["train.mcap"]
    page.unlink()
    page.parent.rmdir()


def test_without_a_browser_it_says_what_to_do(capsys, log, monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    assert main(["log", "replay", str(log)]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"{log.with_name('episode-2.html')}\n"
    assert printed.err == "carrl: no browser was found here; open the page in one\n"


def test_with_rerun_a_recording_is_written_and_shown(run, log, monkeypatch):
    pytest.importorskip("rerun", reason="recordings need it; pip install 'carrl[export]'")
    shown = []
    monkeypatch.setattr("carrl.export.rerun.open_recording", shown.append)
    recording = log.with_name("episode-2.rrd")
    assert run("replay", log, "--rerun") == f"{recording}\n"
    assert shown == [recording]
    assert recording.read_bytes().startswith(b"RRF")


def test_a_name_with_another_ending_is_refused(refused, log, tmp_path):
    assert "its name must end in .html" in refused("replay", log, "--output", tmp_path / "a.txt", "--no-open")
    assert "its name must end in .rrd" in refused("replay", log, "--output", tmp_path / "a.html", "--rerun")
