"""A track's report: its measures, and a sentence for each fault."""

import dataclasses
import re

import numpy as np
import pytest

from carrl.errors import TrackError
from carrl.tracks.centreline import Centreline
from carrl.tracks.inspection import MOST_FAULTS_OF_A_KIND, inspect_track
from carrl.tracks.track import Track, builtin_names
from tests.sim.shapes import rounded_road, straight_road_track


def test_the_report_of_a_stadium_is_worked_by_hand():
    """Two straights of 200 m, joined by half circles of 30 m, 10 m wide."""
    report = inspect_track(straight_road_track())
    assert report.length == pytest.approx(2 * 200 + 2 * np.pi * 30, abs=3)
    assert report.width_min == pytest.approx(10, abs=1e-3)
    assert report.width_max == pytest.approx(10, abs=1e-3)
    assert report.least_radius_left == pytest.approx(30, rel=0.05)
    assert report.least_radius_right is None
    assert (report.gates, report.walls) == (8, 2 * report.points)
    assert (report.bridges, report.folds, report.faults) == ((), 0, ())


@pytest.mark.parametrize("name", builtin_names())
def test_a_builtin_track_has_no_faults(name: str):
    assert inspect_track(Track.load(name)).faults == ()


def test_a_road_narrower_than_the_car_is_a_fault():
    """On a road 1.6 m wide a car of 0.5 m fits, one of 0.9 m does not."""
    track = straight_road_track(width=1.6)
    assert inspect_track(track, body_radius=0.5).faults == ()
    (fault,) = inspect_track(track, body_radius=0.9).faults
    assert re.fullmatch(r"the road is 1\.60 m wide at \d+ m; a car 1\.8 m wide does not fit", fault)


def test_two_stretches_that_overlap_are_a_fault_that_names_both_places():
    """A notch 8 m wide in a road 10 m wide: the stretches to both sides of it lie on each other for 26 m."""
    corners = [(0, 0), (100, 0), (100, 40), (54, 40), (54, 14), (46, 14), (46, 40), (0, 40)]
    faults = inspect_track(rounded_road(corners, 3.0, 10.0)).faults
    assert any(fault.startswith("the walls cross each other at ") for fault in faults)
    assert len(faults) <= 1 + 4 * (MOST_FAULTS_OF_A_KIND + 1)


def test_gates_that_cross_each_other_or_a_wall_are_faults():
    """Gates each 2 m in a bend of 5 m, on a road 8 m to its inner side, folded where the wall cannot follow."""
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    points = 5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    track = Track.from_centreline("ring", Centreline(points, np.full(32, 2.0), np.full(32, 8.0)), gate_spacing=2.0)
    faults = " ".join(inspect_track(track).faults)
    assert "two gates cross each other" in faults


def test_a_wall_that_cuts_the_road_is_a_fault():
    track = straight_road_track()
    left = track.left_wall.clone()
    left[50, 1] = -20.0  # through the road and out on its other side, at 100 m
    faults = inspect_track(dataclasses.replace(track, left_wall=left)).faults
    assert any(fault.startswith("a wall cuts the road at ") for fault in faults)
    assert any(fault.startswith("the walls cross each other at 9") for fault in faults)


def test_many_faults_of_a_kind_are_told_as_a_few_sentences():
    track = straight_road_track(straight=1000.0)
    left = track.left_wall.clone()
    left[20:480:40, 1] = -20.0
    faults = inspect_track(dataclasses.replace(track, left_wall=left)).faults
    crossing = [fault for fault in faults if fault.startswith("the walls cross each other")]
    assert len(crossing) == MOST_FAULTS_OF_A_KIND + 1
    assert crossing[-1] == "the walls cross each other at 7 more places"


def arc(laps: float, wobble: float = 0.0) -> Centreline:
    """So many laps of a ring of 60 m, points 2.5 m apart, whose radius may change from lap to lap by a share."""
    angle = np.arange(0, 2 * np.pi * laps, 2.5 / 60)
    radius = 60 * (1 + wobble * np.sin(angle / laps))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return Centreline(points, *np.full((2, len(points)), 4.0))


def test_a_line_that_is_not_closed_is_a_fault_with_its_gap():
    (fault,) = inspect_track(Track.from_centreline("open", arc(0.9))).faults
    assert fault == (
        "the centreline is not closed: its last point is 38.78 m from its first, and other neighbours are at most "
        "2.50 m apart; draw it back to its first point, with points on the way"
    )


@pytest.mark.parametrize("laps", [0.97, 1.0])
def test_a_gap_of_a_few_steps_is_no_fault(laps: float):
    assert inspect_track(Track.from_centreline("ring", arc(laps))).faults == ()


@pytest.mark.parametrize("wobble", [0.0, 0.01])
@pytest.mark.parametrize("laps", [1.02, 1.1])
def test_a_line_that_goes_on_past_its_start_is_not_called_a_crossing(laps: float, wobble: float):
    with pytest.raises(TrackError, match=r"^track 'lap': the centreline is not closed: .* it goes on past its start$"):
        Track.from_centreline("lap", arc(laps, wobble))


@pytest.mark.parametrize("count", [3, 40])
def test_a_straight_line_is_not_called_a_crossing(count: int):
    points = np.stack([np.linspace(0, 95, count), np.zeros(count)], axis=1)
    with pytest.raises(TrackError, match=r"not closed: its last point is 95\.00 m from its first, .*; draw it back"):
        Track.from_centreline("line", Centreline(points, *np.full((2, count), 4.0)))
