"""`carrl log stats`: its figures, its picture, its refusals."""

import dataclasses
import json

import pytest
from PIL import Image

from tests.cli.log import conftest
from tests.cli.log.conftest import SCENE, write_log


def test_it_prints_how_the_episodes_went(run, log_path):
    printed = run("stats", log_path)
    for words in ("5 episodes ended: 3 by collision", "1 laps", "54 transitions", "forward", "square"):
        assert words in printed


def test_as_json_it_has_the_figures_of_all_episodes(run, log_path):
    document = json.loads(run("stats", log_path, "--json"))
    assert (document["transitions"], document["episodes_ended"], document["laps"]) == (54, 5, 1)
    assert document["actions"] == {
        "forward": {"count": 20, "share": pytest.approx(20 / 54)},
        "left": {"count": 18, "share": pytest.approx(18 / 54)},
        "right": {"count": 16, "share": pytest.approx(16 / 54)},
    }
    assert document["exploratory_share"] == pytest.approx(11 / 54)
    assert document["ended"] == {"collision": 3, "time limit": 2}
    assert document["episodes_lapped"] == 1
    returns = document["episode_return"]
    assert (returns["min"], returns["median"], returns["max"], returns["mean"]) == (-200, -150, 200, -40)
    assert (document["length"]["min"], document["length"]["max"]) == (5, 12)
    assert document["crashes"]["track_name"] == "square"
    assert document["crashes"]["sections"][0]["between"] == "start to 1"
    assert sum(section["count"] for section in document["crashes"]["sections"]) == 3


def test_a_log_without_ended_episodes_says_so(run, tmp_path, monkeypatch):
    monkeypatch.setattr(conftest, "ended_in", lambda *_: [])
    path = write_log(tmp_path / "train.mcap")
    assert "no episode has ended" in run("stats", path)
    document = json.loads(run("stats", path, "--json"))
    assert (document["transitions"], document["episodes_ended"], document["episode_return"]) == (54, 0, None)


def test_the_picture_is_a_png(run, log_path, tmp_path):
    run("stats", log_path, "--png", tmp_path / "stats.png")
    with Image.open(tmp_path / "stats.png") as picture:
        assert picture.format == "PNG"
        assert len(picture.convert("RGB").getcolors(maxcolors=2**24)) > 50


@pytest.mark.parametrize(
    ("name", "says"),
    [("a.jpg", "its name must end in .png"), ("no/a.png", "cannot be written: No such file or directory")],
)
def test_a_picture_that_cannot_be_written_is_one_sentence(refused, log_path, tmp_path, name, says):
    assert says in refused("stats", log_path, "--png", tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_log_that_speaks_of_things_unknown_is_refused(refused, tmp_path):
    fewer = dataclasses.replace(SCENE, action_names=("forward", "left"))
    path = write_log(tmp_path / "train.mcap", scene=fewer)
    assert "has an action without a name" in refused("stats", path)
