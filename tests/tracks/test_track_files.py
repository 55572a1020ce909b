"""Track files beside the usual centreline: AWS DeepRacer's waypoints and drawings in YAML."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
import torch

from carrl.errors import TrackError
from carrl.tracks.drawing_file import DRAWINGS
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track

SQUARE = "corners: [[0, 0], [60, 0], [60, 60], [0, 60]]\n"
SIZES = "corner_radius: 10\nwidth: 8\n"
RING = "points: [[50, 0], [0, 50], [-50, 0], [0, -50]]\n"


@pytest.fixture
def load(tmp_path: Path):
    def load(name: str, content: str | bytes, **options) -> Track:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return Track.load(path, **options)

    return load


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def ring_waypoints(clockwise: bool = False, count: int = 40) -> np.ndarray:
    """A ring road from 4 m to 6 m, as DeepRacer has it: the last row repeats the first."""
    angle = np.linspace(0, (-1 if clockwise else 1) * 2 * np.pi, count + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.hstack([5 * circle, 4 * circle, 6 * circle])


# Waypoints


@pytest.mark.parametrize("clockwise", [False, True])
def test_the_inner_border_is_on_the_left_of_a_counter_clockwise_track_and_else_on_the_right(load, clockwise: bool):
    track = load("ring.npy", npy(ring_waypoints(clockwise)))
    assert track.name == "ring.npy"
    inner, outer = (track.right_wall, track.left_wall) if clockwise else (track.left_wall, track.right_wall)
    torch.testing.assert_close(inner.norm(dim=1), torch.full((40,), 4.0))
    torch.testing.assert_close(outer.norm(dim=1), torch.full((40,), 6.0))
    assert track.length == pytest.approx(10 * np.pi, rel=0.01)
    assert inspect_track(track).faults == ()


def test_the_walls_are_those_of_the_file_and_not_moved_from_the_centreline(load):
    table = ring_waypoints()
    table[7, 2:4] *= 0.9
    assert load("ring.npy", npy(table)).left_wall[7].norm().item() == pytest.approx(3.6)


@pytest.mark.parametrize("change", [np.float32, np.float16, np.asfortranarray, lambda a: a[:-1], lambda a: a[::-1]])
def test_waypoints_load_however_they_are_stored(load, change):
    track = load("ring.NPY", npy(change(ring_waypoints())))
    assert len(track.centreline) == 40
    assert inspect_track(track).faults == ()


def test_a_waypoint_file_that_python_2_wrote_loads_without_a_warning(load):
    content = npy(ring_waypoints()).replace(b"(41, 6), }  ", b"(41L, 6L), }")
    assert len(load("ring.npy", content).centreline) == 40


def test_gates_of_waypoints_stand_as_far_apart_as_asked(load):
    assert load("ring.npy", npy(ring_waypoints()), gate_spacing=5.0).gate_count == 6


def with_value(row: int, column: int, value: float) -> np.ndarray:
    table = ring_waypoints()
    table[row, column] = value
    return table


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not a NumPy array file"),
        (bytes(range(256)), "not a NumPy array file"),
        (npy(ring_waypoints())[:40], "not a NumPy array file"),
        (npy(ring_waypoints())[:-8], "the file ends before its 41 rows do"),
        (npy(ring_waypoints()).replace(b"(41, 6)", b"(9**9, 6)"), "not a NumPy array file"),
        (npy(ring_waypoints()).replace(b"(41, 6), }      ", b"(99999999, 6), }"), "the file ends before its 99999999"),
        (npy(ring_waypoints()).replace(b"(41, 6)", b"(-1, 6)"), r"the array has the shape \(-1, 6\)"),
        (npy(np.array([{"x": 1}, None])), "the array holds object; it must hold plain numbers"),
        (npy(ring_waypoints().astype(complex)), "the array holds complex128"),
        (npy(ring_waypoints().astype(str)), "the array holds <U"),
        (npy(ring_waypoints()[:, :4]), r"the array has the shape \(41, 4\); it must have .* 6 columns: centre x"),
        (npy(ring_waypoints().ravel()), r"the array has the shape \(246,\)"),
        (npy(np.zeros((0, 6))), "0 points; a closed road needs at least 3"),
        (npy(with_value(4, 2, np.nan)), "row 5: inner x is nan; it must be a finite number"),
        (npy(with_value(4, 5, -np.inf)), "row 5: outer y is -inf"),
        (npy(with_value(0, 1, 1e9)), "row 1: centre y is 1e[+]09"),
        (npy(np.repeat(ring_waypoints()[:2], 4, axis=0)), "2 points; a closed road needs at least 3"),
        (npy(np.hstack([ring_waypoints()[:, :4], ring_waypoints()[:, 2:4]])), "both borders lie on the same side"),
    ],
)
def test_bad_waypoints_are_refused_with_one_clear_error(load, content: bytes, says: str):
    with pytest.raises(TrackError, match=rf"^track 'bad\.npy': .*{says}") as error:
        load("bad.npy", content)
    assert "\n" not in str(error.value)


def test_a_folder_and_a_huge_file_of_these_names_are_refused(tmp_path: Path):
    for name, most in (("track.npy", 16 * 2**20), ("track.yaml", 2**18)):
        path = tmp_path / name
        path.mkdir()
        with pytest.raises(TrackError, match=r"this is a folder; name a file in it"):
            Track.load(path)
        path.rmdir()
        with path.open("wb") as file:
            file.truncate(most + 1)
        with pytest.raises(TrackError, match=rf"^track '{name}': the file is too large; .* {most} bytes$"):
            Track.load(path)


# Drawings


def test_the_papers_track_written_as_a_drawing_is_the_papers_track(load):
    drawing, paper = DRAWINGS["paper"], Track.load("paper")
    corners = [list(corner) for corner in drawing.corners]
    track = load("mine.yaml", f"corners: {corners}\ncorner_radius: 9\nwidth: 8\ngates: 8\n")
    assert track.name == "mine.yaml"
    assert torch.equal(track.walls, paper.walls)
    assert torch.equal(track.gates, paper.gates)


@pytest.mark.parametrize("corners", ["[[0, 0], [60, 0], [60, 60], [0, 60]]", "[[0, 0], [0, 60], [60, 60], [60, 0]]"])
def test_a_polygon_is_driven_in_the_order_of_its_corners_from_between_the_first_two(load, corners: str):
    track = load("square.yml", f"corners: {corners}\n{SIZES}")
    first = torch.tensor([30.0, 0.0]) if corners.startswith("[[0, 0], [60") else torch.tensor([0.0, 30.0])
    x, y, heading = track.pose_at(torch.zeros(1))[0].tolist()
    assert (x, y) == pytest.approx(first.tolist(), abs=1e-4)
    assert heading == pytest.approx(0.0 if first[0] else np.pi / 2, abs=1e-3)
    report = inspect_track(track)
    assert report.length == pytest.approx(4 * 40 + 2 * np.pi * 10, rel=0.01)
    assert (report.width_min, report.width_max) == pytest.approx((8, 8))
    assert report.faults == ()


def test_a_smooth_line_goes_through_all_its_points(load):
    points = torch.tensor([[50.0, 0], [0, 50], [-50, 0], [0, -50]])
    track = load("ring.yaml", RING + "width: 8\n")
    distances = torch.cdist(points, track.centreline).min(dim=1).values
    assert distances.max() < 1.1  # the curve's points stand 2 m apart
    assert torch.equal(track.centreline[0], points[0])
    assert inspect_track(track).least_radius_left > 25
    assert track.length == pytest.approx(2 * np.pi * 50, rel=0.05)


def test_a_line_that_is_not_smooth_has_its_own_points_only(load):
    track = load("ring.yaml", RING + "width: 8\nsmooth: false\n")
    assert track.centreline.tolist() == [[50, 0], [0, 50], [-50, 0], [0, -50]]


def test_widths_may_change_from_point_to_point(load):
    track = load("ring.yaml", "points: [[50, 0, 4], [0, 50, 8], [-50, 0, 4], [0, -50, 8], [50, 0, 4]]\n")
    report = inspect_track(track)
    assert (report.width_min, report.width_max) == pytest.approx((4, 8), abs=0.05)
    assert track.clearance_at(torch.zeros(1))[0].tolist() == pytest.approx([2, 2], abs=0.05)


def test_a_drawn_line_may_cross_itself_on_a_bridge(load):
    eight = "[[0, 0], [30, 25], [60, 25], [75, 0], [60, -25], [30, -25], [0, 0.1], [-30, 25], [-60, 25], [-75, 0], \
              [-60, -25], [-30, -25]]"
    track = load("eight.yaml", f"points: {eight}\nwidth: 8\n")
    assert len(track.bridges) == 1
    assert inspect_track(track).faults == ()


def test_a_drawing_says_how_many_gates_it_has_or_how_far_apart_they_stand(load):
    assert load("a.yaml", SQUARE + SIZES + "gates: 5").gate_count == 5
    length = load("a.yaml", SQUARE + SIZES).length
    assert load("a.yaml", SQUARE + SIZES + "gate_spacing: 10").gate_count == round(length / 10)
    assert load("a.yaml", SQUARE + SIZES).gate_count == round(length / 30)
    assert load("a.yaml", SQUARE + SIZES + "gates: 5", gate_spacing=20.0).gate_count == round(length / 20)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "the file is empty"),
        ("# nothing\n", "the file is empty"),
        ("12", "this is 12; it must be keys with values"),
        ("- a\n- b\n", r"this is \['a', 'b'\]; it must be keys with values"),
        ("corners: [[0, 0\n", "line 2: this is not YAML"),
        ("a: b: c", "line 1: this is not YAML"),
        (b"\xff\xfe\x00\x01", "not a YAML text file"),
        (bytes(range(256)), "not a YAML text file"),
        ("[" * 5000, "not (YAML|a YAML text file)"),
        ("!!python/object/apply:os.system ['true']", "line 1: this is not YAML: could not determine a constructor"),
        ("when: 2024-99-99", "not a YAML text file"),
        (
            "image: map.png\nresolution: 0.05\n",
            "this map lacks origin, negate, occupied_thresh, free_thresh; nav2's map saver writes negate: 0",
        ),
        (SIZES, "it has neither; it must have one of corners and points"),
        (SQUARE + RING + SIZES, "it has corners and points; it must have one of"),
        (SQUARE + SIZES + "colour: red", "unknown key colour; with corners the keys are corners, corner_radius, width"),
        (RING + SIZES, "unknown key corner_radius; with points the keys are points, width, smooth, gates, gate_spac"),
        (SQUARE + "corner_radius: 10", "the key width is missing"),
        (SQUARE + "width: 8", "the key corner_radius is missing"),
        (SQUARE + SIZES + "width: 9", "the key width stands in it twice"),
        (SQUARE + "corner_radius: ten\nwidth: 8", "corner_radius is 'ten'; it must be a number of metres"),
        (SQUARE + "corner_radius: .nan\nwidth: 8", "corner_radius is nan; it must be a number"),
        (SQUARE + "corner_radius: 10\nwidth: true", "width is True; it must be a number"),
        (SQUARE + "corner_radius: 10\nwidth: -8", "width is -8 m; it must be at least 0.01 m"),
        (SQUARE + f"corner_radius: 10\nwidth: 0x{'f' * 5000}", "width is .*; it must be a number"),
        (SQUARE + "corner_radius: 40\nwidth: 8", "corner_radius is 40 m, and the road .* has no room for it"),
        (SQUARE.replace("60", "6000") + "corner_radius: 0.1\nwidth: 8\n", "24,000 m long; at this .* most 3,333 m"),
        ("corners: 5\n" + SIZES, r"corners is 5; it must be a list with a row \[x, y\]"),
        ("corners: [[0, 0], [60, 0]]\n" + SIZES, "2 corners; a closed road needs at least 3"),
        ("corners: [[0, 0], [60, 0], [0, 0]]\n" + SIZES, "2 corners; a closed road needs at least 3"),
        ("corners: [[0, 0], 60, [60, 60]]\n" + SIZES, r"corners: row 2 is 60; it must be \[x, y\]"),
        ("corners: [[0, 0], [60, 0, 5], [60, 60]]\n" + SIZES, r"corners: row 2 is \[60, 0, 5\]; it must be \[x, y\]"),
        ("corners: [[0, 0], [60, up], [60, 60]]\n" + SIZES, "corners: row 2: y is 'up'; it must be a number"),
        ("corners: [[0, 0], [60, 0], [.inf, 60]]\n" + SIZES, "corners: row 3: x is inf; it must be"),
        ("corners: [[0, 0], [60, 0], [1000000, 60]]\n" + SIZES, "corners: row 3: x is 1000000; .* at most 100000"),
        ("corners: [[0, 0], [60, 0], [60, 0], [0, 0]]\n" + SIZES, "2 corners; a closed road needs at least 3"),
        ("corners: [[0, 0], [60, 60], [60, 0], [0, 60]]\n" + SIZES, "the corners' outline crosses itself"),
        (
            RING,
            r"points: row 1 is \[50, 0\]; it must be \[x, y, width\] or \[x, y, right, left\], or width must be given",
        ),
        ("points: [[50, 0, 4], [0, 50, 0], [-50, 0, 4]]", "points: row 2: width is 0 m; widths must be positive"),
        ("points: [[50, 0, 4], [0, 50, 4], [-50, 0, 4]]\nwidth: 4", r"row 1 is \[50, 0, 4\]; it must be \[x, y\], si"),
        ("points: [[-0.01, 0], [0.01, 0], [-0.01, 0], [0.01, 0]]\nwidth: 9", "too small to be drawn, or turns back on"),
        (RING + "width: 8\nsmooth: maybe", "smooth is 'maybe'; it must be true or false"),
        (SQUARE + SIZES + "gates: 2", "gates is 2; it must be a whole number from 3 to 2"),
        (SQUARE + SIZES + "gates: 8.0", "gates is 8.0; it must be a whole number"),
        (SQUARE + SIZES + "gates:", "gates is None; it must be a whole number"),
        (SQUARE + SIZES + "gates: 8\ngate_spacing: 30", "it has gates and gate_spacing; give one of the two"),
        (SQUARE + SIZES + "gate_spacing: 0.1", "gate_spacing is 0.1 m; it must be at least 1 m"),
        ("a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]\n" + SQUARE, "unknown key a, b, c"),
    ],
)
def test_a_bad_drawing_is_refused_with_one_clear_error(load, content: str | bytes, says: str):
    with pytest.raises(TrackError, match=rf"^track 'bad\.yaml': .*{says}") as error:
        load("bad.yaml", content)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def test_a_small_file_that_stands_for_a_huge_list_is_refused_at_once(load):
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    for content in ("corners: [*a11, *a11, *a11]\n", "corners: *a11\n"):
        with pytest.raises(TrackError, match=r"^track 'bomb\.yaml': line \d+: its aliases stand for more"):
            load("bomb.yaml", "\n".join([*lines, content]) + SIZES)
    nested = "corners: [&a [&b [1, 1, 1, 1, 1, 1], *b, *b, *b, *b, *b], *a, *a]\n"
    with pytest.raises(TrackError, match=re.escape("corners: row 1 is [[1, 1")):
        load("bomb.yaml", nested + SIZES)


def test_waypoints_that_signal_that_they_are_no_numbers_are_refused_without_a_warning(tmp_path):
    table = np.full((4, 6), 0x7FA00000, dtype=np.uint32).view(np.float32)
    np.save(tmp_path / "signals.npy", table)
    with pytest.raises(TrackError, match="it must be a finite number of metres"):
        Track.load(tmp_path / "signals.npy")
