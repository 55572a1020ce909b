"""Roads in another size, the other way round, from another start, and written in other formats."""

from pathlib import Path

import numpy as np
import pytest
import torch
from shapely import LinearRing

from carrl.errors import TrackError
from carrl.tracks.adjust import walls_apart
from carrl.tracks.convert import convert, files_of
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track, builtin_names
from tests.tracks.test_track_files import npy, ring_waypoints

SHARED = Path(__file__).parents[3] / "shared" / "tracks"
NAMES = (
    "real/Austin.csv",
    "real/Suzuka.csv",
    "f1tenth/aut.yaml",
    "f1tenth/esp.yaml",
    "f1tenth/gbr.yaml",
    "f1tenth/mco.yaml",
)
CIRCUITS = [SHARED / name for name in NAMES if (SHARED / name).is_file()]


@pytest.fixture
def model_road(tmp_path) -> Path:
    path = tmp_path / "ring.npy"
    path.write_bytes(npy(ring_waypoints()))
    return path


def test_a_scale_of_10_makes_a_model_cars_road_one_for_a_car(model_road):
    small, large = Track.load(model_road), Track.load(model_road, scale=10)
    torch.testing.assert_close(large.left_wall, 10 * small.left_wall)
    assert large.length == pytest.approx(10 * small.length)
    assert small.gate_count == 3
    assert large.gate_count == round(large.length / 30)
    assert Track.load(model_road, 5.0, scale=10).gate_count == round(large.length / 5)


@pytest.mark.parametrize("name", builtin_names())
def test_a_builtin_track_keeps_its_gates_at_any_scale(name):
    track = Track.load(name, scale=0.1)
    assert track.gate_count == Track.load(name).gate_count
    assert track.length == pytest.approx(Track.load(name).length / 10, rel=1e-3)
    assert inspect_track(track, body_radius=0.05).faults == ()


def test_a_bridge_is_one_at_any_scale(tmp_path):
    eight = "points: [[-40, -30], [40, 30], [90, 0], [40, -30], [-40, 30], [-90, 0]]\nwidth: 8\n"
    (tmp_path / "eight.yaml").write_text(eight)
    assert len(Track.load(tmp_path / "eight.yaml", scale=3.0).bridges) == 1


@pytest.mark.parametrize(
    ("scale", "says"),
    [(0, "scale is 0; it must be a number from 0.001 to 1000"), (-1, "scale is -1"), (float("nan"), "scale is nan"),
     (True, "scale is True"), ("10", "scale is '10'"), (1e9, "scale is 1000000000.0"),
     (1e3, "at scale 1000 it is too small, or reaches further than 100000 m")],
)  # fmt: skip
def test_a_scale_that_is_none_is_refused(tmp_path, scale, says):
    square = "corners: [[0, 0], [600, 0], [600, 60], [0, 60]]\ncorner_radius: 10\nwidth: 8\n"
    (tmp_path / "square.yaml").write_text(square)
    with pytest.raises(TrackError, match=rf"^track 'square\.yaml': {says}"):
        Track.load(tmp_path / "square.yaml", scale=scale)


@pytest.mark.parametrize("place", [[1e9, 0], [0, -300], [float("inf"), 0]])
def test_a_start_that_is_nowhere_near_the_road_is_refused(model_road, place):
    with pytest.raises(TrackError, match=r"start_at is \[.*\](, far beyond the road, which is from \[|; it must be)"):
        Track.load(model_road, start_at=place)


def test_an_even_figure_eight_goes_neither_way_round(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rows = np.stack([200 * np.sin(angle), 100 * np.sin(2 * angle), 0 * angle + 4, 0 * angle + 4], axis=1)
    np.savetxt(tmp_path / "eight.csv", rows, delimiter=",")
    with pytest.raises(TrackError, match="direction is clockwise, but it goes as far around to one side as to the oth"):
        Track.load(tmp_path / "eight.csv", direction="clockwise")


def test_a_direction_turns_only_tracks_that_go_the_other_way(model_road):
    track = Track.load(model_road)
    assert LinearRing(track.centreline.numpy()).is_ccw
    same, other = (Track.load(model_road, direction=each) for each in ("counterclockwise", "clockwise"))
    torch.testing.assert_close(same.centreline, track.centreline)
    torch.testing.assert_close(other.centreline, track.reversed().centreline)
    torch.testing.assert_close(other.left_wall, track.reversed().left_wall)
    assert other.name == track.name


def test_the_start_line_is_put_where_it_is_wished(model_road):
    track = Track.load(model_road, start_at=(0.0, -7.0))
    assert track.centreline[0].tolist() == pytest.approx([0.0, -5.0], abs=0.02)
    assert track.left_wall[0].tolist() == pytest.approx([0.0, -4.0], abs=0.02)
    assert track.length == pytest.approx(Track.load(model_road).length, rel=1e-3)
    between = Track.load(model_road, start_at=(3.5, 3.6))  # half-way along a piece of the centreline
    assert between.centreline[0].tolist() == pytest.approx([5 * 3.5 / 5.02, 5 * 3.6 / 5.02], abs=0.05)


# Conversion


@pytest.mark.parametrize("ending", [".csv", ".yaml", ".npy", ".png", ".pgm"])
@pytest.mark.parametrize("name", [*builtin_names(), "ring"])
def test_walls_read_back_within_the_tolerance(tmp_path, model_road, name, ending):
    track = Track.load(model_road if name == "ring" else name)
    done = convert(track, tmp_path / f"written{ending}")
    assert done.files == files_of(tmp_path / f"written{ending}")
    assert all(file.is_file() for file in done.files)
    assert done.apart < (done.tolerance if ending in (".png", ".pgm") else 1e-3)


@pytest.mark.parametrize("ending", [".csv", ".yaml", ".npy", ".png"])
@pytest.mark.parametrize("path", CIRCUITS, ids=lambda path: path.name)
def test_walls_of_real_circuits_read_back_within_the_tolerance(tmp_path, path, ending):
    track = Track.load(path)
    if track.bridges and ending == ".png":
        with pytest.raises(TrackError, match="it crosses itself on a bridge, and a map has one level"):
            convert(track, tmp_path / "written.png")
        return
    done = convert(track, tmp_path / f"written{ending}")
    assert done.apart <= done.tolerance


def test_a_drawing_keeps_gates_and_different_widths_to_both_sides(tmp_path):
    text = "points: [[50, 0, 2, 5], [0, 50, 3, 5], [-50, 0, 2, 4], [0, -50, 2, 5]]\nsmooth: false\ngates: 7\n"
    (tmp_path / "drawn.yaml").write_text(text)
    track = Track.load(tmp_path / "drawn.yaml")
    assert (track.left_wall - track.centreline).norm(dim=1).min() > 3.9
    convert(track, tmp_path / "again.yaml")
    again = Track.load(tmp_path / "again.yaml")
    assert again.gate_count == 7
    assert walls_apart(track, again) < 1e-3
    (tmp_path / "bad.yaml").write_text("points: [[50, 0, 2], [0, 50, 3, 5], [-50, 0, 2]]\n")
    with pytest.raises(TrackError, match=r"points: row 2 is \[0, 50, 3, 5\]; it must be"):
        Track.load(tmp_path / "bad.yaml")


def test_walls_apart_is_the_largest_distance_between_walls():
    one, other = Track.load("oval"), Track.load("oval", scale=1.1)
    assert walls_apart(one, one) < 1e-5
    corner = one.right_wall.norm(dim=1).max().item()
    assert 0.05 * corner < walls_apart(one, other) < 0.15 * corner


def test_waypoints_are_closed_and_have_the_inner_border_first_as_those_of_aws(tmp_path):
    convert(Track.load("paper", direction="clockwise"), tmp_path / "paper.npy")
    table = np.load(tmp_path / "paper.npy")
    assert (table[0] == table[-1]).all()
    assert np.abs(table[:, 2:4] - table[:, 2:4].mean(0)).sum() < np.abs(table[:, 4:] - table[:, 4:].mean(0)).sum()


@pytest.mark.parametrize(
    ("name", "resolution", "says"),
    [("a.txt", None, "must end in .csv, .yaml"), ("a.csv", 0.1, "a resolution is for maps"),
     ("a.png", 0.0, "the resolution is 0"), ("a.png", 1e-3, "has more than 16,777,216; use a coarser --resolution")],
)  # fmt: skip
def test_a_conversion_that_cannot_be_is_refused(tmp_path, name, resolution, says):
    with pytest.raises(TrackError, match=says):
        convert(Track.load("oval"), tmp_path / name, resolution)
    assert list(tmp_path.iterdir()) == []
