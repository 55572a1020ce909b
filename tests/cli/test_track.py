"""`carrl track` as typed."""

import json
from pathlib import Path

import pytest
import torch
from PIL import Image

from carrl.cli.main import main
from carrl.config import build_node
from carrl.tracks.track import Track, builtin_names
from carrl.train.overrides import name_files
from tests.configs import compose

NARROW = "corners: [[0, 0], [60, 0], [60, 60], [0, 60]]\ncorner_radius: 10\nwidth: 0.8\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_list_names_every_builtin_track(capsys):
    assert main(["track", "list"]) == 0
    output = capsys.readouterr().out
    assert all(name in output for name in builtin_names())
    assert main(["track", "list", "--json"]) == 0
    tracks = json.loads(capsys.readouterr().out)
    assert [track["name"] for track in tracks] == builtin_names()
    assert tracks[0]["length"] == pytest.approx(Track.load("oval").length)
    assert tracks[0]["least_radius_right"] is None


def test_check_reports_a_sound_track_and_exits_with_0(capsys):
    assert main(["track", "check", "paper"]) == 0
    output = capsys.readouterr().out
    for text in ("paper", "236.8 m", "8.0 m", "bridges", "fault"):
        assert text in output


def test_check_exits_with_1_for_a_fault_and_names_it(capsys, folder):
    (folder / "narrow.yaml").write_text(NARROW)
    assert main(["track", "check", "paper", "narrow.yaml"]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("fault: the road is 0.80 m wide at ")
    assert main(["track", "check", "narrow.yaml", "--body-radius", "0.2"]) == 0


def test_check_exits_with_2_for_what_is_no_track_and_still_checks_the_others(capsys, folder):
    (folder / "narrow.yaml").write_text(NARROW)
    (folder / "empty.csv").write_text("")
    assert main(["track", "check", "empty.csv", "narrow.yaml", "paper", "--json"]) == 2
    output = capsys.readouterr()
    documents = json.loads(output.out)
    assert [document["path"] for document in documents] == ["empty.csv", "narrow.yaml", "paper"]
    assert documents[0]["error"].startswith("track 'empty.csv': the file is empty")
    assert len(documents[1]["faults"]) == 1
    assert documents[2]["faults"] == []
    assert output.err == f"carrl: {documents[0]['error']}\n"


def test_show_draws_a_picture_and_says_where(capsys, folder):
    assert main(["track", "show", "paper"]) == 0
    assert capsys.readouterr().out == "paper.png\n"
    assert main(["track", "show", "paper", "--out", "map.png"]) == 0
    assert main(["track", "show", "paper", "--out", "map.svg"]) == 0
    assert (folder / "map.svg").read_bytes().startswith(b"<?xml")
    with Image.open(folder / "map.png") as image:
        assert image.format == "PNG"
        assert image.width > 500


def test_show_draws_a_road_that_crosses_itself(capsys, folder):
    eight = [[80, 0], [57, 40], [0, 0.5], [-57, -40], [-80, 0], [-57, 40], [0, -0.5], [57, -40]]
    (folder / "eight.yaml").write_text(f"points: {eight}\nwidth: 8\n")
    assert len(Track.load("eight.yaml").bridges) == 1
    assert main(["track", "show", "eight.yaml"]) == 0
    assert (folder / "eight.png").stat().st_size > 10_000


def test_random_writes_a_file_that_loads_as_the_same_track(capsys, folder):
    assert main(["track", "random", "--seed", "7"]) == 0
    assert capsys.readouterr().out == "random-7.csv\n"
    loaded, drawn = Track.load("random-7.csv"), Track.random(7)
    torch.testing.assert_close(loaded.walls, drawn.walls, atol=1e-3, rtol=0)
    torch.testing.assert_close(loaded.gates, drawn.gates, atol=1e-3, rtol=0)
    assert [path.name for path in folder.iterdir()] == ["random-7.csv"]
    assert main(["track", "show", "random-7.csv"]) == 0
    assert main(["track", "check", "random-7.csv"]) == 0


def test_random_takes_measures_as_numbers_or_ranges(capsys):
    measures = ["--width", "7", "--length", "300", "400", "--corner-radius", "9"]
    assert main(["track", "random", *measures, "--out", "mine.csv", "--json"]) == 0
    (document,) = json.loads(capsys.readouterr().out)
    assert document["path"] == "mine.csv"
    assert document["width_max"] == pytest.approx(7, abs=1e-3)
    assert 297 < document["length"] < 404


def test_random_takes_the_whole_shape_of_a_circuit():
    shape = ["--length", "900", "--corner-spacing", "3", "8", "--widening", "0.5", "--hairpins", "1"]
    assert main(["track", "random", "--seed", "4", *shape]) == 0
    drawn = Track.random(4, length=900.0, corner_spacing=(3.0, 8.0), widening=0.5, hairpins=1.0)
    torch.testing.assert_close(Track.load("random-4.csv").walls, drawn.walls, atol=1e-3, rtol=0)


def test_random_writes_several_circuits_each_under_its_seed(folder):
    assert main(["track", "random", "--seed", "3", "--count", "3", "--out", "town.csv"]) == 0
    assert sorted(path.name for path in folder.iterdir()) == ["town-3.csv", "town-4.csv", "town-5.csv"]


def test_random_replaces_a_file_only_when_told(capsys, folder):
    (folder / "mine.csv").write_text("precious")
    assert main(["track", "random", "--out", "mine.csv"]) == 2
    assert capsys.readouterr().err == (
        "carrl: 'mine.csv' is there already; choose another --out, or --force to replace it\n"
    )
    assert (folder / "mine.csv").read_text() == "precious"
    assert main(["track", "random", "--out", "mine.csv", "--force"]) == 0
    assert Track.load("mine.csv").gate_count > 3


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["show", "nowhere"], "track 'nowhere': no file of this path"),
        (["show", "paper", "--out", "map.jpg"], "--out is 'map.jpg'; its name must end in .png, .pdf or .svg"),
        (["show", "paper", "--out", "no/map.png"], "'no/map.png' cannot be written: No such file or directory"),
        (["check", "paper", "--body-radius", "-1"], "--body-radius is -1.0; it must be a positive number"),
        (["random", "--count", "0"], "--count is 0; it must be at least 1"),
        (["random", "--seed", "-1"], "seed is -1; it must be a whole number from 0 on"),
        (["random", "--width", "20", "--corner-radius", "5"], "corner_radius is at most 5 m"),
        (["random", "--hairpins", "2"], "hairpins is 2.0; it must be a share between 0 and 1"),
        (["random", "--width", "1", "2", "3"], "width is [1.0, 2.0, 3.0]; it must be"),
        (["random", "--out", "track.txt"], "--out is 'track.txt'; the track is a CSV file"),
        (["random", "--out", "no/track.csv"], "'no/track.csv' cannot be written: No such file or directory"),
    ],
)
def test_bad_input_is_answered_with_one_sentence_and_exit_code_2(capsys, folder, arguments, says):
    assert main(["track", *arguments]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert says in output.err
    assert output.err.count("\n") == 1
    assert list(folder.iterdir()) == []


def test_a_random_track_is_an_option_of_the_track_group():
    node = compose("track=random", "track.seed=7", "track.width=8", "track.length=[300,400]")["track"]
    track = build_node("track", node)
    assert track.name == "random-7"
    assert 297 < track.length < 404


# Other formats


def test_convert_writes_a_map_and_says_how_well_it_reads_back(folder, capsys):
    assert main(["track", "convert", "oval", "ring.png", "--scale", "0.1", "--resolution", "0.02"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["ring.png", "ring.yaml", "ring_centerline.csv"]
    assert lines[3].startswith("read back, its walls are within 0.0")
    assert main(["track", "check", "ring.yaml", "--body-radius", "0.1", "--json"]) == 0
    (document,) = json.loads(capsys.readouterr().out)
    assert document["length"] == pytest.approx(Track.load("oval").length / 10, rel=0.01)
    assert document["notes"] == ["centreline, start and direction from ring_centerline.csv"]
    assert main(["track", "check", "ring.yaml", "--scale", "10"]) == 0
    assert "212" in capsys.readouterr().out


def test_convert_replaces_nothing_unless_forced(folder, capsys):
    (folder / "ring.yaml").write_text("mine")
    assert main(["track", "convert", "oval", "ring.png"]) == 2
    assert "'ring.yaml' is there already; choose another OUT, or --force" in capsys.readouterr().err
    assert not (folder / "ring.png").exists()
    assert main(["track", "convert", "oval", "ring.png", "--force"]) == 0
    assert main(["track", "convert", "oval", "ring.txt"]) == 2
    assert "must end in .csv" in capsys.readouterr().err


def test_show_draws_what_was_found_in_a_map_that_holds_no_circuit(folder, capsys):
    Image.new("L", (40, 40), 254).save(folder / "room.png")
    (folder / "room.yaml").write_text(
        "image: room.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    assert main(["track", "show", "room.yaml"]) == 2
    output = capsys.readouterr()
    assert output.out == "room-found.png\n"
    assert "no closed corridor" in output.err
    with Image.open(folder / "room-found.png") as picture:
        assert picture.width > 500


def test_the_library_is_listed_with_its_bad_files_in_one_table(folder, capsys, monkeypatch):
    (folder / "mine" / "deep").mkdir(parents=True)
    monkeypatch.setenv("CARRL_TRACKS", str(folder / "mine"))
    assert main(["track", "convert", "oval", "mine/deep/Ring.csv"]) == 0
    for name in ("bad.csv", "worse.npy"):
        (folder / "mine" / name).write_text("nothing")
    capsys.readouterr()
    assert main(["track", "list"]) == 2
    output = capsys.readouterr()
    assert "deep/Ring.csv" in output.out and "serpentine" in output.out
    assert "2 files that are no tracks" in output.err
    assert "bad.csv" in output.err and "worse.npy" in output.err
    assert main(["track", "check", "Ring"]) == 0
    assert main(["track", "show", "Ring"]) == 0


def test_a_folder_without_a_circuit_does_not_hide_the_others_of_the_library(folder, capsys, monkeypatch):
    for name in ("good", "bad", "empty"):
        (folder / name).mkdir()
    assert main(["track", "convert", "oval", "good/Ring.csv"]) == 0
    (folder / "bad" / "notes.csv").write_text("to do")
    monkeypatch.setenv("CARRL_TRACKS", "bad:empty:good")
    capsys.readouterr()
    assert main(["track", "list"]) == 2
    out, err = capsys.readouterr()
    assert all(name in out for name in ("oval", "serpentine", "Ring.csv"))
    assert "2 files that are no tracks" in err
    assert "notes.csv" in err and "empty" in err


def test_a_run_takes_a_track_of_the_library_by_its_name_and_at_any_scale(folder, monkeypatch):
    (folder / "mine").mkdir()
    monkeypatch.setenv("CARRL_TRACKS", str(folder / "mine"))
    assert main(["track", "convert", "oval", "mine/Ring.csv"]) == 0
    path = str(folder / "mine" / "Ring.csv")
    assert name_files("track=Ring") == ["track=file", f"track.name_or_path='{path}'"]
    assert name_files("track=Ring,oval") == ["track=file", f"track.name_or_path='{path}',oval"]
    assert name_files("track=oval") == ["track=oval"]
    config = compose("track=file", f"track.name_or_path={path}", "track.scale=2", "track.start_at=[0,0]")
    track = build_node("track", config["track"])
    assert track.length == pytest.approx(2 * Track.load("oval").length, rel=1e-3)


def test_a_run_takes_a_circuit_whose_name_is_a_number(folder):
    line = {"type": "LineString", "coordinates": [[0, 0], [0.002, 0], [0.002, 0.002], [0, 0.002], [0, 0]]}
    features = [{"type": "Feature", "properties": {"id": number}, "geometry": line} for number in (2, 1)]
    (folder / "rings.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    config = compose("track=file", "track.name_or_path=rings.geojson", "track.circuit=2")
    assert build_node("track", config["track"]).name == "rings.geojson/2"


def test_check_looks_at_all_circuits_of_a_file_or_at_the_one_that_is_named(folder, capsys):
    line = {"type": "LineString", "coordinates": [[0, 0], [0.002, 0], [0.002, 0.002], [0, 0.002], [0, 0]]}
    features = [{"type": "Feature", "properties": {"id": name}, "geometry": line} for name in ("one", "two")]
    (folder / "rings.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert main(["track", "check", "rings.geojson", "--json"]) == 0
    assert [each["name"] for each in json.loads(capsys.readouterr().out)] == ["rings.geojson/one", "rings.geojson/two"]
    assert main(["track", "check", "rings.geojson", "--circuit", "two"]) == 0
    assert "no widths, so 12 m unless track.width says otherwise" in capsys.readouterr().out
    assert main(["track", "show", "rings.geojson"]) == 2
    assert "it has 2 circuits, one, two; name one as track.circuit" in capsys.readouterr().err
