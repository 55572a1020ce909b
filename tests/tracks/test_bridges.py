"""Where the road crosses itself, two stretches are told apart."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import torch
from shapely import LineString

from carrl.errors import TrackError
from carrl.tracks.bridges import MARGIN, Bridge, on_stretch, on_two_decks
from carrl.tracks.centreline import Centreline
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track
from tests.sim.shapes import figure_eight


def assert_the_stretches_hold_all_walls_that_meet(track: Track) -> None:
    """By brute force over all pairs of walls whose stations are not near each other."""
    lines = [LineString(wall) for wall in track.walls.double().numpy()]
    stations = track.wall_stations.numpy()
    meeting = 0
    for one, other in combinations(range(len(lines)), 2):
        apart = abs(stations[one] - stations[other])
        if min(apart, track.length - apart) > 30 and lines[one].intersects(lines[other]):
            pair = stations[[one]], stations[[other]]
            assert on_two_decks(track.bridges, track.length, *pair)[0]
            meeting += 1
    assert meeting >= 4


def test_a_figure_eight_has_one_bridge_about_its_crossing():
    track = figure_eight()
    (bridge,) = track.bridges
    quarter = track.length / 4
    assert sum(bridge.under) / 2 == pytest.approx(quarter, abs=2)
    assert sum(bridge.over) / 2 == pytest.approx(3 * quarter, abs=2)
    # The lines cross at 90 degrees in a square of the road's width; its walls are 2 m long at most.
    for begin, end in (bridge.over, bridge.under):
        assert 8 < end - begin < 8 + 2 * (2 * 2.1 + MARGIN)
    assert inspect_track(track).faults == ()


@pytest.mark.parametrize("turn", np.linspace(0, 2 * np.pi, 9))
def test_the_stretches_hold_every_wall_that_meets_one_of_the_other_wherever_the_start_is(turn: float):
    track = figure_eight(turn=turn)
    assert_the_stretches_hold_all_walls_that_meet(track)
    for begin, end in (track.bridges[0].over, track.bridges[0].under):
        assert 0 <= begin < track.length
        assert begin < end < begin + 30
    assert inspect_track(track).faults == ()


def test_a_road_that_crosses_itself_three_times_has_three_bridges():
    angle = np.linspace(0, 4 * np.pi, 400, endpoint=False)
    radius = 100 + 60 * np.cos(3 * angle / 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    half = np.full(len(points), 3.0)
    track = Track.from_centreline("trefoil", Centreline(points, half, half))
    assert len(track.bridges) == 3
    assert_the_stretches_hold_all_walls_that_meet(track)
    assert inspect_track(track).faults == ()


@pytest.mark.parametrize("change", [Track.mirrored, Track.reversed])
@pytest.mark.parametrize("turn", [0.0, np.pi / 2])
def test_a_mirrored_or_reversed_track_keeps_its_bridges(change, turn: float):
    track = change(figure_eight(turn=turn))
    assert len(track.bridges) == 1
    assert_the_stretches_hold_all_walls_that_meet(track)
    assert inspect_track(track).faults == ()


def test_a_reversed_bridge_is_worked_by_hand():
    bridge = Bridge(over=(90.0, 104.0), under=(20.0, 30.0))
    assert bridge.reversed(100.0) == Bridge(over=(96.0, 110.0), under=(70.0, 80.0))
    assert bridge.reversed(100.0).reversed(100.0) == Bridge(over=(90.0, 104.0), under=(20.0, 30.0))


def test_a_stretch_over_the_start_line_holds_stations_on_both_sides_of_it():
    stations = np.array([89.0, 91.0, 99.0, 0.0, 3.0, 5.0])
    assert on_stretch(stations, (90.0, 104.0), 100.0).tolist() == [False, True, True, True, True, False]


def test_a_road_without_a_crossing_has_no_bridge():
    assert Track.load("serpentine").bridges == ()


def test_suzuka_has_one_bridge_and_no_faults(real_circuits: Path):
    track = Track.load(real_circuits / "Suzuka.csv")
    (bridge,) = track.bridges
    assert bridge.under[0] == pytest.approx(2540, abs=10)
    assert bridge.over[0] == pytest.approx(4914, abs=10)
    assert inspect_track(track).faults == ()
    walls, stations = track.walls.double().numpy(), track.wall_stations.numpy()
    over, under = (walls[on_stretch(stations, stretch, track.length)] for stretch in (bridge.over, bridge.under))
    assert sum(LineString(one).intersects(LineString(other)) for one in over for other in under) == 4


def test_gates_and_rooms_of_a_figure_eight_are_as_on_any_road():
    track = figure_eight()
    room = track.clearance_at(torch.arange(0, track.length, 3.0))
    torch.testing.assert_close(room, torch.full_like(room, 4.0), atol=0.15, rtol=0)
    assert track.gate_count == round(track.length / 30)


@pytest.mark.parametrize(
    ("points", "says"),
    [
        ([(0, 0), (40, 40), (40, 0), (0, 40)], "where its two stretches of road run into each other"),
        ([(0, 0), (60, 0), (30, 0)], "by turning back onto itself"),
        ([(0, 0), (60, 0), (60, 60), (0, 60), (0, 40), (2, 40), (-2, 41), (0, 38)], "run into each other"),
    ],
    ids=["a bow tie as narrow as the road", "there and back", "a curl"],
)
def test_a_crossing_that_cannot_be_a_bridge_is_refused_in_one_sentence(points, says: str):
    half = np.full(len(points), 4.0)
    with pytest.raises(TrackError, match=rf"^track 'knot': the centreline crosses itself.* {says}"):
        Track.from_centreline("knot", Centreline(np.array(points, dtype=float), half, half))


def test_two_bridges_that_share_a_stretch_are_refused():
    """A long straight that two parallel stretches cross, 10 m apart: their bridges touch."""
    corners = [(0, 0), (200, 0), (200, 60), (105, 60), (105, -60), (95, -60), (95, 60), (0, 60)]
    points = np.concatenate(
        [np.linspace(a, b, 40, endpoint=False) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
    )
    half = np.full(len(points), 4.5)
    with pytest.raises(TrackError, match=r"^track 'comb': the (road|centreline) crosses itself at"):
        Track.from_centreline("comb", Centreline(points, half, half))
