"""Folds of the inner wall in bends tighter than the road is wide are cut, and nothing else is."""

import numpy as np
import pytest
import torch
from shapely import LinearRing, LineString, Point

from carrl.tracks.bridges import count_folds, cut_folds
from carrl.tracks.centreline import Centreline
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track
from tests.sim.shapes import random_track, rounded_road

CORNER = [(0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0)]


def test_the_inner_wall_of_a_sharp_corner_turns_where_its_two_straights_cross():
    """A square of 40 m with a point each 10 m: 12 m beside it, the wall is a square from 12 m to 28 m."""
    points = np.array(
        [(x, 0) for x in range(0, 40, 10)]
        + [(40, y) for y in range(0, 40, 10)]
        + [(x, 40) for x in range(40, 0, -10)]
        + [(0, y) for y in range(40, 0, -10)],
        dtype=float,
    )
    wall = np.clip(points, 12, 28)
    folded = Centreline(points, np.full(16, 2.0), np.full(16, 12.0)).walls()[0]
    assert not LinearRing(folded).is_simple
    cut = cut_folds(folded, points)
    straight = [1, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15]
    np.testing.assert_allclose(cut[straight], wall[straight], atol=1e-9)
    assert LinearRing(cut).is_simple


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("point_spacing", [0.5, 2.0, 5.0])
@pytest.mark.parametrize(
    "corners", [CORNER, CORNER[::-1], [(0, 0), (100, 0), (20, 40)]], ids=["left", "right", "acute"]
)
def test_a_road_with_bends_tighter_than_its_half_width_has_no_faults(radius, point_spacing, corners):
    track = rounded_road(corners, radius, 10.0, point_spacing)
    assert inspect_track(track).faults == ()
    assert len(track.left_wall) == len(track.right_wall) == len(track.centreline)
    assert (track.walls[:, 0] - track.walls[:, 1]).norm(dim=1).min() > 0
    assert len(track.walls) == len(track.wall_stations)


def test_folds_are_counted_once_for_each_bend():
    track = rounded_road(CORNER, 1.0, 10.0)
    assert inspect_track(track).folds == 4
    assert count_folds(track.right_wall.numpy()) == 0
    assert len(track.walls) < 2 * len(track.centreline)


def test_the_walls_without_length_are_left_out_and_the_others_keep_their_order():
    track = rounded_road(CORNER, 1.0, 10.0)
    lefts = torch.stack([track.left_wall, track.left_wall.roll(-1, 0)], dim=1)
    kept = lefts[(lefts[:, 0] != lefts[:, 1]).any(dim=1)]
    assert torch.equal(track.walls[: len(kept)], kept)
    assert torch.equal(kept[:, 1], kept[:, 0].roll(-1, 0))  # still closed
    assert (track.wall_stations[: len(kept)].diff() > 0).all()


def test_no_place_of_a_cut_wall_is_nearer_to_the_road_than_its_half_width():
    track = rounded_road(CORNER, 1.0, 10.0, point_spacing=0.5)
    middle = LinearRing(track.centreline.double().numpy())
    assert min(middle.distance(Point(point)) for point in track.left_wall.double().numpy()) > 4.9


def test_a_wall_without_folds_is_returned_as_it_is():
    centreline = random_track(0).centreline.double().numpy()
    wall = random_track(0).left_wall.double().numpy()
    assert cut_folds(wall, centreline) is wall


def test_two_legs_whose_walls_overlap_for_long_are_no_fold():
    """A hairpin of 3 m radius between two straights of 100 m, the road 10 m wide."""
    track = rounded_road([(0, 0), (150, 0), (150, 6.2), (50, 6.2), (50, 60), (0, 60)], 3.0, 10.0)
    assert inspect_track(track).faults


def test_the_gates_of_a_folded_road_still_span_it():
    track = rounded_road(CORNER, 1.0, 10.0)
    for gate in track.gates.double().numpy():
        assert LineString(gate).intersects(LinearRing(track.centreline.double().numpy()))


@pytest.mark.parametrize("seed", range(30))
def test_random_rings_have_no_faults_after_their_folds_are_cut(seed: int):
    track = random_track(seed)
    assert isinstance(track, Track)
    assert inspect_track(track).faults == ()
