"""Circuits to learn on and others to be tried out on."""

import math

import pytest
import torch

from carrl.errors import TrackError
from carrl.tracks.circuits import circuit_files, make_circuits
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track


def write_ring(path, radius):
    """A round circuit, 8 m wide."""
    angles = [2 * math.pi * k / 60 for k in range(60)]
    rows = [f"{radius * math.cos(angle)},{radius * math.sin(angle)},4,4" for angle in angles]
    path.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]))


def test_circuits_to_be_tried_out_on_are_not_among_those_to_learn_on():
    circuits = make_circuits(count=3, validation=2, seed=7)
    assert [track.name for track in circuits.training] == ["random-7", "random-8", "random-9"]
    assert [track.name for track in circuits.validation] == ["random-10", "random-11"]
    shapes = {track.centreline.numpy().tobytes() for track in (*circuits.training, *circuits.validation)}
    assert len(shapes) == 5
    assert circuits.name == "3 circuits"


def test_the_circuits_of_a_folder_are_learnt_on_after_the_random_ones(tmp_path):
    write_ring(tmp_path / "b.csv", 30.0)
    write_ring(tmp_path / "a.csv", 40.0)
    (tmp_path / "LICENSE").write_text("free")
    circuits = make_circuits(count=1, validation=1, folder=str(tmp_path), gate_spacing=20.0)
    assert [track.name for track in circuits.training] == ["random-0", "a.csv", "b.csv"]
    assert circuits.training[1].gate_count == round(2 * math.pi * 40 / 20)
    assert [track.name for track in circuits.validation] == ["random-1"]
    alone = make_circuits(count=0, validation=1, folder=str(tmp_path))
    assert [track.name for track in alone.training] == ["a.csv", "b.csv"]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"count": 0, "validation": 1}, "track.count is 0 and track.folder names no folder"),
        ({"count": 1, "validation": 0}, "track.validation is 0"),
        ({"count": -1, "validation": 1}, "track.count is -1"),
        ({"count": 512, "validation": 1}, "together at most 512"),
        ({"count": 1, "validation": 1, "folder": "nowhere"}, "folder 'nowhere' cannot be read"),
        ({"count": 1, "validation": 1, "widening": -1}, "widening is -1"),
    ],
)
def test_bad_circuits_are_refused(values, message):
    with pytest.raises(TrackError, match=message):
        make_circuits(**values)


def test_a_folder_without_circuits_is_refused(tmp_path):
    (tmp_path / "SOURCE.txt").write_text("nothing")
    with pytest.raises(TrackError, match=r"has 0 files that end in \.csv"):
        circuit_files(tmp_path)


def test_a_widened_road_is_wider_in_places_and_nowhere_narrower():
    plain, widened = (Track.random(3, width=8.0, widening=widening) for widening in (0.0, 1.0))
    assert (plain.centreline == widened.centreline).all()
    report = inspect_track(widened)
    assert report.width_min == pytest.approx(8.0, abs=0.01)
    assert 10.0 < report.width_max <= 16.01
    assert report.faults == ()


def test_a_road_that_is_not_widened_is_drawn_as_ever():
    track = Track.random(3, widening=0.0)
    assert (track.left_wall == Track.random(3).left_wall).all()
    widths = (track.left_wall - track.right_wall).norm(dim=1)
    assert widths.max().item() == pytest.approx(widths.min().item(), abs=1e-3)


def test_corners_that_stand_further_apart_leave_longer_straights():
    def straight_share(spacing):
        tracks = [Track.random(seed, corner_radius=10.0, length=1000.0, corner_spacing=spacing) for seed in range(8)]
        headings = [track.pose_at(torch.arange(0, track.length, 5.0).double())[:, 2] for track in tracks]
        turns = torch.cat([each.diff() for each in headings]).sin()
        return (turns.abs() < 0.02).double().mean().item()

    assert straight_share(8.0) > 1.3 * straight_share([1.5, 3.0])


def test_corners_cannot_stand_no_distance_apart():
    with pytest.raises(TrackError, match="corner_spacing is 0; it must be a number of least radii or a range"):
        Track.random(0, corner_spacing=0)


def sharpest_turn(track):
    """The most that the heading changes within 40 m, rad."""
    heading = track.pose_at(torch.arange(0, track.length, 2.0).double())[:, 2]
    steps = torch.cat([heading, heading[:20]]).diff()
    return torch.atan2(steps.sin(), steps.cos()).unfold(0, 20, 1).sum(1).abs().max().item()


def test_hairpins_are_corners_that_turn_further_than_others():
    def share_of_acute(hairpins):
        shape = {"corner_radius": 8.0, "width": 8.0, "length": 1000.0, "corner_spacing": 6.0, "hairpins": hairpins}
        turns = [sharpest_turn(Track.random(seed, **shape)) for seed in range(40)]
        return sum(turn > math.radians(135) for turn in turns) / len(turns)

    assert share_of_acute(1.0) > 0.7
    assert share_of_acute(0.0) < 0.3


def test_circuits_with_hairpins_measure_what_was_wished_and_have_no_fault():
    for seed in range(50):
        track = Track.random(seed, corner_radius=9.0, width=10.0, length=900.0, corner_spacing=5.0, hairpins=1.0)
        report = inspect_track(track)
        assert report.length == pytest.approx(900.0, rel=0.01)
        assert report.faults == ()


@pytest.mark.parametrize("seed", [1024, 1054, 1058])
def test_a_circuit_keeps_three_corners_however_many_are_hairpins(seed):
    """The first shape that each of these seeds draws is a single cell, whose four corners are two U-turns."""
    track = Track.random(seed, (8.0, 20.0), (8.0, 18.0), (600.0, 1800.0), 5.0, 1.0, (2.5, 12.0), 0.6)
    assert inspect_track(track).faults == ()
    assert 590 < track.length < 1810


def test_a_circuit_without_hairpins_is_drawn_as_ever():
    assert (Track.random(3, hairpins=0.0).left_wall == Track.random(3).left_wall).all()


@pytest.mark.parametrize("hairpins", [-0.1, 1.1, True, float("nan")])
def test_hairpins_are_a_share(hairpins):
    with pytest.raises(TrackError, match=r"hairpins is .*; it must be a share between 0 and 1"):
        Track.random(0, hairpins=hairpins)
