"""`carrl laps` as typed."""

import json

import pytest
from PIL import Image

from carrl.cli.main import main
from carrl.tracks.track import Track
from tests.driven_laps import steady, write_trace


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    track = Track.load("oval")
    write_trace(tmp_path / "fast.csv", track, steady(track, 25.0))
    write_trace(tmp_path / "slow.csv", track, steady(track, 20.0))
    write_trace(tmp_path / "part.csv", track, steady(track, 20.0, end=100.0))
    return tmp_path


def test_it_prints_times_and_gaps_to_the_first_lap(capsys):
    assert main(["laps", "oval", "fast.csv", "slow.csv", "part.csv"]) == 0
    output = capsys.readouterr().out
    fast, slow, part = (next(line for line in output.splitlines() if name in line) for name in ("fast", "slow", "part"))
    assert "8.50" in fast and "flying" in fast
    assert "10.62" in slow and "+2.12" in slow
    assert "ended at 100 m" in part


def test_json_is_one_document(capsys):
    assert main(["laps", "oval", "slow.csv", "fast.csv", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["track"] == "oval"
    slow, fast = document["laps"]
    assert (slow["name"], fast["name"], slow["gap_s"]) == ("slow", "fast", 0)
    assert fast["gap_s"] == pytest.approx(212.454 / 25 - 212.454 / 20, abs=2e-3)
    assert sum(fast["sector_times_s"]) == pytest.approx(fast["lap_time_s"], abs=2e-3)


def test_it_writes_what_the_names_end_in(capsys, folder):
    assert main(["laps", "oval", "fast.csv", "slow.csv", "--out", "laps.html", "--out", "laps.png"]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == ["laps.html", "laps.png"]
    assert "<canvas" in (folder / "laps.html").read_text()
    with Image.open(folder / "laps.png") as image:
        assert image.width > 800


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["oval"], "the following arguments are required: LAP.csv"),
        (["oval", "none.csv"], "none.csv"),
        (["moon", "fast.csv"], "moon"),
        (["serpentine", "fast.csv"], "its laps are of oval"),
        (["oval", "fast.csv", "--out", "laps.txt"], "--out is 'laps.txt'; its name must end in one of: .html, .mp4"),
        (["oval", "fast.csv", "--out", "./fast.csv"], "--out is 'fast.csv'; its name must end in one of"),
        (["oval", "fast.csv", "--video", "laps.mp4"], "unrecognized arguments: --video"),
        (["oval", "fast.csv", "--out", "no/folder.html"], "no/folder.html"),
        (["oval", "fast.csv", "--out", "a.png", "--out", "a.png"], "--out is given twice for 'a.png'"),
        (["oval", "fast.csv", "--out", "a.png", "--out", "fast.csv/b.html"], "Not a directory; choose another place"),
    ],
)
def test_a_mistake_is_one_sentence(arguments, says, capsys, folder):
    assert main(["laps", *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not list(folder.glob("*.png"))


def test_a_lap_that_is_read_is_not_written_over(capsys, folder):
    (folder / "lap.html").write_bytes((folder / "fast.csv").read_bytes())
    assert main(["laps", "oval", "lap.html", "--out", "lap.html"]) == 2
    assert "a lap that is to be read; choose another name" in capsys.readouterr().err
