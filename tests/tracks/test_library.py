"""Tracks by name from the folders of `CARRL_TRACKS`."""

import os

import pytest

from carrl.errors import TrackError
from carrl.tracks.circuits import load_folder, make_circuits
from carrl.tracks.convert import convert
from carrl.tracks.library import find_file
from carrl.tracks.track import Track


@pytest.fixture
def folders(tmp_path, monkeypatch):
    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one / "deep", other, one / ".hidden"):
        folder.mkdir(parents=True)
    convert(Track.load("oval"), one / "deep" / "Ring.csv")
    convert(Track.load("paper"), other / "Sheet.yaml")
    convert(Track.load("oval"), other / "Map.png", 0.2)
    convert(Track.load("oval"), one / ".hidden" / "Ghost.csv")
    monkeypatch.setenv("CARRL_TRACKS", f"{one}{os.pathsep}{other}")
    return tmp_path


def test_a_name_is_looked_up_in_all_folders_with_or_without_its_ending(folders):
    assert find_file("Ring") == folders / "one" / "deep" / "Ring.csv"
    assert find_file("Sheet.yaml") == folders / "other" / "Sheet.yaml"
    assert Track.load("Map").length == pytest.approx(Track.load("oval").length, rel=0.01)
    assert find_file("Ghost") is None
    with pytest.raises(TrackError, match="no file of this path and no built-in track of this name"):
        Track.load("Ghost")


def test_a_file_where_one_is_comes_before_the_library(folders, monkeypatch):
    monkeypatch.chdir(folders)
    convert(Track.load("paper"), folders / "Ring.csv")
    assert Track.load("Ring.csv").length == pytest.approx(Track.load("paper").length, rel=1e-3)


def test_a_name_that_two_files_have_is_answered_with_both(folders):
    convert(Track.load("oval"), folders / "other" / "Ring.npy")
    with pytest.raises(
        TrackError, match=r"track 'Ring': 2 files of CARRL_TRACKS have this name: .*Ring\.csv, .*Ring\.npy"
    ):
        Track.load("Ring")
    assert Track.load("Ring.npy").name == "Ring.npy"


def test_a_folder_of_the_library_that_is_not_there_is_named(folders, monkeypatch):
    monkeypatch.setenv("CARRL_TRACKS", str(folders / "nowhere"))
    with pytest.raises(TrackError, match=r"CARRL_TRACKS names '.*nowhere', which is no folder; correct it or unset it"):
        Track.load("Ring")


def test_a_name_that_no_file_of_the_library_has_is_said_to_have_been_looked_up(folders):
    with pytest.raises(TrackError, match=r"none in the folders of CARRL_TRACKS has this name; see carrl track list$"):
        Track.load("Ghost")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Map.png", r"this is a picture; name the YAML file beside it that makes it a map$"),
        (
            "laps.npz",
            r"this is not a CSV text file; as its name ends in none of \.csv, .*\.geojson, it was read as CSV$",
        ),
        ("laps.json", r"name it \.geojson, \.xml or \.xodr; as its name ends in none of"),
    ],
)
def test_a_file_of_no_known_ending_is_told_which_there_are(folders, name, says):
    path = folders / "other" / name
    if not path.exists():
        path.write_bytes(b"{" if name.endswith("json") else b"\xff\xfe")
    with pytest.raises(TrackError, match=f"^track '{name}': .*{says}"):
        Track.load(path)


def test_what_belongs_to_a_track_is_no_circuit_of_its_own(folders):
    assert (folders / "other" / "Map_centerline.csv").is_file()
    found = load_folder(folders / "other")
    assert [track.name for track in found.tracks] == ["Map.yaml", "Sheet.yaml"]
    assert found.refused == {}
    (folders / "other" / "Lone_raceline.csv").write_text("# x_m,y_m\n0,0\n9,0\n9,9\n")
    assert [path.name for path in load_folder(folders / "other").refused] == ["Lone_raceline.csv"]


def test_a_scale_without_a_folder_is_refused_and_not_ignored():
    with pytest.raises(TrackError, match=r"track\.scale is 10, but track\.folder names no folder to scale"):
        make_circuits(count=1, validation=1, scale=10)


def test_a_folder_is_scaled_as_a_whole(folders):
    lengths = [track.length for track in load_folder(folders / "other").tracks]
    scaled = [track.length for track in load_folder(folders / "other", scale=10).tracks]
    assert scaled == pytest.approx([10 * length for length in lengths], rel=1e-3)
