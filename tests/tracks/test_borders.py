"""Waypoint files whose rows repeat, or whose borders do not stand abreast of the centre."""

import io
from pathlib import Path

import numpy as np
import pytest
import torch

from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track
from carrl.tracks.waypoint_file import cut_abreast, is_abreast


def circle(radius: float, angle: np.ndarray) -> np.ndarray:
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def ring(skew: float = 0.0, clockwise: bool = False, count: int = 100) -> np.ndarray:
    """A road from 4.5 m to 5.5 m whose inner border runs ahead by an angle, rad; the last row closes it."""
    angle = np.linspace(0, (-1 if clockwise else 1) * 2 * np.pi, count + 1)
    return np.hstack([circle(5.0, angle), circle(4.5, angle + skew), circle(5.5, angle)])


@pytest.fixture
def load(tmp_path: Path):
    def load(table: np.ndarray) -> Track:
        file = io.BytesIO()
        np.save(file, table)
        (tmp_path / "ring.npy").write_bytes(file.getvalue())
        return Track.load(tmp_path / "ring.npy", gate_spacing=2.0)

    return load


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("skew", [0.5, -0.754, 1.2])
def test_a_border_that_runs_ahead_is_cut_abreast_of_the_centre(load, skew: float, clockwise: bool):
    track = load(ring(skew, clockwise))
    report = inspect_track(track, body_radius=0.1)
    assert report.faults == ()
    assert report.width_min == pytest.approx(1.0, abs=0.01)
    assert report.width_max == pytest.approx(1.0, abs=0.01)
    gates = (track.gates[:, 0] - track.gates[:, 1]).norm(dim=1)
    torch.testing.assert_close(gates, torch.ones_like(gates), atol=0.01, rtol=0)
    room = track.clearance_at(torch.linspace(0, track.length, 50))
    torch.testing.assert_close(room, torch.full_like(room, 0.5), atol=0.01, rtol=0)


def test_a_border_that_stands_abreast_is_left_as_it_is():
    table = ring()[:-1]
    assert cut_abreast(table[:, :2], table[:, 2:4], is_left=True) is not None
    assert (cut_abreast(table[:, :2], table[:, 2:4], is_left=True) == table[:, 2:4]).all()
    assert not is_abreast(table[:, :2], ring(0.5)[:-1, 2:4])


def test_a_border_that_a_normal_does_not_meet_is_cut_between_its_neighbours():
    """The inner border lies at a quarter of the road's radius, and a dent of the centreline looks past it."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    centre, border = circle(8.0, angle), circle(2.0, angle + 0.6)
    centre[10] += [-0.6, 0.9]
    cut = cut_abreast(centre, border, is_left=True)
    np.testing.assert_allclose(np.linalg.norm(cut, axis=1), 2.0, atol=0.01)
    steps = np.diff(np.unwrap(np.arctan2(cut[:, 1], cut[:, 0])))
    assert (steps > -1e-9).all()


def test_a_border_that_no_normal_meets_is_left_as_it_is():
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    centre = 10 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inside = 0.5 * np.stack([np.cos(angle + 2), np.sin(angle + 2)], axis=1)  # and said to be on the outer side
    np.testing.assert_array_equal(cut_abreast(centre, inside, is_left=False), inside)


@pytest.mark.parametrize("copies", [1, 3])
def test_rows_that_repeat_the_one_before_are_left_out_and_counted(load, copies: int):
    table = ring()
    repeated = np.insert(table, [40] * copies, table[40] + 0.001, axis=0)
    track, plain = load(repeated), load(table)
    assert (track.repeats, plain.repeats) == (copies, 0)
    assert inspect_track(track).repeats == copies
    assert len(track.centreline) == len(plain.centreline) == 100
    assert inspect_track(track, body_radius=0.1).faults == ()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", "x,y,width_right,width_left\n0,0,2,3\n40,0,2,3\n40,0.005,2,3\n40,40,2,3\n0,40,2,3\n0,0,2,3\n"),
        ("a.yaml", "points: [[0, 0], [40, 0], [40, 0.005], [40, 40], [0, 40], [0, 0]]\nwidth: 5\nsmooth: false\n"),
        ("b.yaml", "corners: [[0, 0], [40, 0], [40, 0.005], [40, 40], [0, 40], [0, 0]]\nwidth: 5\ncorner_radius: 9\n"),
    ],
)
def test_repeated_points_are_left_out_of_every_format(tmp_path: Path, name: str, content: str):
    (tmp_path / name).write_text(content)
    report = inspect_track(Track.load(tmp_path / name))
    assert (report.repeats, report.faults) == (1, ())


def test_the_centrelines_of_the_f1tenth_survey_load_although_they_have_no_header(real_circuits: Path):
    folder = real_circuits.parent / "f1tenth"
    if not folder.is_dir():
        pytest.skip("the optional folder ../shared/tracks/f1tenth of the survey's circuits is absent")
    for name in ("aut", "esp", "gbr", "mco"):
        track = Track.load(folder / f"{name}_centerline.csv")
        assert inspect_track(track, body_radius=0.15).faults == ()
