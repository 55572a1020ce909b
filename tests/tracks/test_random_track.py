"""Random circuits: as long, as wide and as tight as wished, the same for the same seed, and always sound."""

import re

import numpy as np
import pytest
import torch

from carrl.errors import TrackError
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track

SEEDS = range(100)


@pytest.fixture(scope="module")
def tracks() -> list[Track]:
    return [Track.random(seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def reports(tracks):
    return [inspect_track(track) for track in tracks]


def least_radius(report) -> float:
    return min(radius for radius in (report.least_radius_left, report.least_radius_right) if radius is not None)


def is_counter_clockwise(track: Track) -> bool:
    x, y = track.centreline.double().numpy().T
    return (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0


def test_no_random_circuit_has_a_fault(reports):
    assert [report.faults for report in reports if report.faults] == []


def test_the_measures_are_spread_over_their_default_ranges(reports):
    lengths = [report.length for report in reports]
    widths = [report.width_max for report in reports]
    radii = [least_radius(report) for report in reports]
    for values, low, high in ((lengths, 195, 805), (widths, 6, 12.01), (radii, 8, 20.5)):
        assert low <= min(values) < low + 0.2 * (high - low)
        assert high - 0.2 * (high - low) < max(values) <= high


def test_the_road_is_equally_wide_everywhere(reports):
    for report in reports:
        assert report.width_max - report.width_min < 1e-3


def test_the_points_stand_at_most_two_metres_apart(tracks):
    for track in tracks:
        assert (track.centreline.roll(-1, 0) - track.centreline).norm(dim=1).max() <= 2.001


def test_circuits_are_driven_both_ways_round_and_most_turn_both_ways(tracks, reports):
    assert 30 < sum(map(is_counter_clockwise, tracks)) < 70
    both = [r for r in reports if r.least_radius_left and r.least_radius_right and least_radius(r) > 0]
    assert len(both) > 70


def test_no_two_seeds_draw_the_same_circuit(tracks):
    assert len({round(track.length, 3) for track in tracks}) == len(tracks)


def test_the_start_is_on_a_straight(tracks):
    for track in tracks:
        heading = track.pose_at(torch.tensor([-3.0, 0.0, 3.0]))[:, 2]
        assert torch.cos(heading - heading[0]).min() > 0.999


@pytest.mark.parametrize("seed", [0, 7, 123456789])
def test_the_same_seed_draws_the_same_circuit(seed: int):
    one, other = Track.random(seed), Track.random(seed)
    assert one.name == f"random-{seed}"
    assert torch.equal(one.walls, other.walls)
    assert torch.equal(one.gates, other.gates)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    ("radius", "width", "length"), [(8.0, 6.0, 600.0), (12.0, 12.0, 300.0), (20.0, 10.0, 200.0), (9, 14, 700)]
)
def test_a_circuit_measures_what_was_wished(seed: int, radius: float, width: float, length: float):
    report = inspect_track(Track.random(seed, corner_radius=radius, width=width, length=length))
    assert report.length == pytest.approx(length, rel=0.01)
    assert report.width_min == pytest.approx(width, abs=1e-3)
    assert least_radius(report) >= 0.999 * radius
    assert report.faults == ()


def test_a_range_of_one_measure_is_narrowed_to_what_the_others_allow():
    for seed in range(20):
        report = inspect_track(Track.random(seed, width=20.0))
        assert least_radius(report) >= 10.99
        report = inspect_track(Track.random(seed, corner_radius=5.0))
        assert report.width_max <= 8.001


def test_gates_stand_as_far_apart_as_asked():
    track = Track.random(3, gate_spacing=10.0)
    assert track.gate_count == round(track.length / 10)
    assert Track.random(3).gate_count == round(track.length / 30)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"seed": -1}, "seed is -1; it must be a whole number from 0 on"),
        ({"seed": 1.5}, "seed is 1.5; it must be a whole number"),
        ({"seed": True}, "seed is True; it must be a whole number"),
        ({"width": 0}, "width is 0; it must be a number of metres or a range [low, high], positive"),
        ({"width": float("nan")}, "width is nan; it must be"),
        ({"width": "wide"}, "width is 'wide'; it must be"),
        ({"width": [8, 6]}, "width is [8, 6]; it must be"),
        ({"width": [6, 7, 8]}, "width is [6, 7, 8]; it must be"),
        ({"length": float("inf")}, "length is inf; it must be"),
        ({"length": 1e9}, "at most 10000"),
        ({"corner_radius": [0, 5]}, "corner_radius is [0, 5]; it must be"),
        (
            {"corner_radius": 5, "width": 10},
            "corner_radius is at most 5 m; for a width of 10 m it must be at least 6 m, half the width and 1 m",
        ),
        (
            {"corner_radius": 20, "length": 150},
            "length is at most 150 m; with a corner_radius of 20 m it must be at least 200 m",
        ),
        ({"gate_spacing": 0.1}, "gate_spacing is 0.1; it must be a number of at least 1.0 m"),
    ],
)
def test_measures_that_no_circuit_has_are_refused_in_one_sentence(values, says: str):
    with pytest.raises(TrackError, match=re.escape(says)) as error:
        Track.random(**{"seed": 0, **values})
    assert "\n" not in str(error.value)
