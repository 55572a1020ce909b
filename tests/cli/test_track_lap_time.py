"""`carrl track lap-time` as typed."""

import json
import sys

import pytest
from PIL import Image

from carrl.cli.main import main
from carrl.racing.reference_line import ReferenceLine

LAP = ["track", "lap-time", "oval", "--spacing", "5"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def test_it_prints_the_time_and_writes_picture_and_line(capsys, folder):
    assert main([*LAP, "--png", "lap.png", "--csv", "lap.csv"]) == 0
    output = capsys.readouterr().out
    for text in ("minimum lap time, single track", "at the limit of grip", "at a wall", "iterations"):
        assert text in output
    line = ReferenceLine.read(folder / "lap.csv")
    assert f"{line.lap_time:.3f} s" in output
    with Image.open(folder / "lap.png") as image:
        assert image.width > 500 and image.height > 700


def test_json_is_one_document_with_figures_and_checks(capsys):
    exit_code = main([*LAP, "vehicle.friction=0.9", "--check", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert document["track"] == "oval" and document["vehicle"]["friction"] == 0.9
    assert 11.5 < document["lap_time_s"] < 13
    assert exit_code == int(not all(check["passed"] for check in document["checks"]))
    assert [check["name"] for check in document["checks"]][:2] == ["two grids", "another method"]


def test_quick_is_the_point_mass_and_faster_than_the_car(capsys):
    times = []
    for flags in ([], ["--quick"]):
        assert main([*LAP, *flags, "--json"]) == 0
        times.append(json.loads(capsys.readouterr().out)["lap_time_s"])
    assert 0.95 * times[0] < times[1] < times[0]


def test_words_may_stand_in_any_order(capsys):
    times = []
    for words in (["vehicle.friction=0.9", "oval", "--quick"], ["oval", "--quick", "vehicle.friction=0.9"]):
        assert main(["track", "lap-time", *words, "--spacing", "5", "--json"]) == 0
        times.append(json.loads(capsys.readouterr().out)["lap_time_s"])
    assert times[0] == times[1]
    assert main(["track", "lap-time", "vehicle.friction=0.9"]) == 2
    assert "a track is missing" in capsys.readouterr().err


def test_a_failed_check_is_exit_code_1(capsys, monkeypatch):
    monkeypatch.setattr("carrl.racing.checks.GRIDS", 0.0)
    assert main([*LAP, "--check"]) == 1
    assert "FAILED" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["vehicle=kinematic"], "this is a Kinematic; choose that one, with a vehicle.preset"),
        (["seed=3"], "'seed=3' says nothing of the car; write vehicle.KEY=VALUE, such as vehicle.friction=0.9"),
        (["vehicle.preset=f1"], "vehicle.preset is 'f1'; it must be race or commonroad_2 or f1tenth"),
        (["vehicle.grip=1"], "there is no key vehicle.grip"),
        (["--chekc"], "unrecognized arguments: --chekc"),
        (["--quick", "--check"], "leave one of them out"),
        (["--quick", "vehicle.preset=f1tenth"], "leave out --quick"),
        (["--png", "lap.gif"], "--png is 'lap.gif'; its name must end in .png, .pdf or .svg"),
        (["--csv", "lap.txt"], "--csv is 'lap.txt'; its name must end in .csv"),
        (["--force"], "--force is for --csv, which is not given; leave it out"),
        (["--spacing", "nan"], "--spacing is nan; it must be more than 0"),
        (["--margin", "nan"], "--margin is nan; it must be 0 or more"),
    ],
)
def test_a_mistake_is_one_sentence(arguments, says, capsys):
    assert main([*LAP, *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_a_file_of_yours_is_not_replaced(capsys, folder):
    (folder / "lap.csv").write_text("precious")
    assert main([*LAP, "--csv", "lap.csv"]) == 2
    assert "is there already; choose another --csv, or --force to replace it" in capsys.readouterr().err
    assert (folder / "lap.csv").read_text() == "precious"


def test_without_casadi_it_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    assert main(LAP) == 2
    assert capsys.readouterr().err == (
        "carrl: the minimum lap time needs casadi, which is not installed; pip install 'carrl[racing]'\n"
    )
