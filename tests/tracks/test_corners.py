"""Corners drawn by hand: the road keeps its width around them, whatever points a file gives beside them."""

from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest
from shapely import LinearRing

from carrl.tracks.centreline import Centreline
from carrl.tracks.drawing_file import DRAWINGS
from carrl.tracks.inspection import inspect_track
from carrl.tracks.random_track import CORNER_RADIUS, LENGTH, WIDTH, random_centrelines
from carrl.tracks.track import Track


def square(
    side: float = 50.0, spacing: float = 50.0, half_width: float = 4.0, turn: float = 0.0, first: int = 0
) -> Track:
    """A square road driven counter-clockwise from a point of its first side, turned by an angle, rad."""
    along = np.arange(0, side, spacing)
    zero, far = np.zeros_like(along), np.full_like(along, side)
    points = np.concatenate(
        [*zip([along, far, side - along, zero], [zero, along, far, side - along], strict=True)], axis=1
    )
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = np.roll(points.T, -first, axis=0) @ rotation
    return Track.from_centreline("square", Centreline(points, *np.full((2, len(points)), half_width)))


@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize(("spacing", "first"), [(50.0, 0), (50.0, 1), (1.0, 0), (1.0, 7), (0.5, 3), (12.5, 0)])
def test_a_square_road_is_as_wide_as_its_file_says_all_round(spacing, first, turn):
    track = square(spacing=spacing, first=first, turn=turn)
    left, right = (LinearRing(wall.double().numpy()) for wall in (track.left_wall, track.right_wall))
    assert left.length == pytest.approx(4 * 42, abs=1e-3)
    assert right.length == pytest.approx(4 * 58, abs=1e-3)
    assert left.distance(right) == pytest.approx(8.0, abs=1e-4)
    report = inspect_track(track)
    assert report.width_min == pytest.approx(8.0, abs=1e-4)
    assert report.faults == ()


def test_a_corner_is_mitred_on_both_sides_of_the_road_and_both_ways_round():
    track = square()
    assert track.left_wall.tolist() == [[4, 4], [46, 4], [46, 46], [4, 46]]
    assert track.right_wall.tolist() == [[-4, -4], [54, -4], [54, 54], [-4, 54]]
    points = track.centreline.double().numpy()[::-1]
    clockwise = Track.from_centreline("back", Centreline(points, np.full(4, 3.0), np.full(4, 5.0)))
    assert clockwise.right_wall.tolist() == [[3, 47], [47, 47], [47, 3], [3, 3]]
    assert clockwise.left_wall.tolist() == [[-5, 55], [55, 55], [55, -5], [-5, -5]]


def test_a_spike_has_no_mitre_without_end():
    points = np.array([[0.0, 0.0], [60.0, 3.0], [0.0, 6.0], [-30.0, 3.0]])
    walls = Centreline(points, np.full(4, 1.0), np.full(4, 1.0)).walls()
    assert max(np.linalg.norm(wall - points, axis=1).max() for wall in walls) < 4.0


def test_a_road_that_narrows_beside_a_corner_is_measured_from_wall_to_wall():
    """A kink of 40 degrees is not mitred: the road is 6 m wide there, times the cosine of 20 degrees."""
    angle = np.radians(40)
    points = np.array([[0, 0], [50, 0], [50 + 50 * np.cos(angle), 50 * np.sin(angle)], [50, 100], [0, 60]])
    report = inspect_track(Track.from_centreline("kink", Centreline(points, *np.full((2, 5), 3.0))))
    assert report.width_min == pytest.approx(6 * np.cos(angle / 2), abs=1e-4)


GENERALIST = ([8.0, 20.0], [8.0, 18.0], [600.0, 1800.0], 1.0, [2.5, 12.0], 0.6)


def centrelines() -> Iterator[Centreline]:
    """Of the built-in tracks and of random circuits, as they are and as experiment=generalist draws them."""
    yield from (drawing.centreline() for drawing in DRAWINGS.values())
    for seed in range(12):
        yield from islice(random_centrelines(seed, CORNER_RADIUS, WIDTH, LENGTH), 2)
        yield from islice(random_centrelines(seed, *GENERALIST), 2)


def test_the_walls_of_rounded_roads_are_their_points_moved_sideways_to_the_bit():
    """What is learnt on them depends on the last bit."""
    for centreline in centrelines():
        tangent = np.roll(centreline.points, -1, axis=0) - np.roll(centreline.points, 1, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        to_left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        left, right = centreline.walls()
        assert (left == centreline.points + to_left * centreline.width_left[:, None]).all()
        assert (right == centreline.points - to_left * centreline.width_right[:, None]).all()
