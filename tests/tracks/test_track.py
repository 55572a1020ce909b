"""Tracks: the built-in drawings, centreline files good and bad, gates."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from shapely import LinearRing, LineString

from carrl.errors import TrackError
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks import centreline
from carrl.tracks.centreline import Centreline
from carrl.tracks.drawing_file import DRAWINGS
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track, builtin_names
from tests.sim.shapes import straight_road_track
from tests.sim.steering import steer

HEADER = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n"
SQUARE = "0,0,2,3\n40,0,2,3\n40,40,2,3\n0,40,2,3\n"
CIRCUITS = [
    "Austin",
    "Budapest",
    "Catalunya",
    "IMS",
    "Melbourne",
    "MexicoCity",
    "MoscowRaceway",
    "Norisring",
    "Nuerburgring",
    "Oschersleben",
    "Sakhir",
    "Silverstone",
    "Spa",
    "Spielberg",
    "rounded_rectangle",
]


@pytest.fixture
def load_text(tmp_path: Path):
    def load(content: str | bytes) -> Track:
        path = tmp_path / "square.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return Track.load(path)

    return load


def ring(side: torch.Tensor) -> LinearRing:
    return LinearRing(side.double().numpy())


def curvature(points: np.ndarray) -> np.ndarray:
    """Signed curvature of the circle through each point and its neighbours, 1/m, positive to the left."""
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    area = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    lengths = [np.linalg.norm(side, axis=1) for side in (before, after, before + after)]
    return 2 * area / np.prod(lengths, axis=0)


# Built-in tracks


def test_the_builtin_tracks_are_listed_by_name():
    assert builtin_names() == ["oval", "paper", "serpentine", "grand_prix"]


@pytest.mark.parametrize("name", builtin_names())
def test_a_builtin_track_is_a_closed_counter_clockwise_ring_of_evenly_spaced_points(name: str):
    track = Track.load(name)
    assert track.name == name
    assert ring(track.centreline).is_ccw
    spacing = (track.centreline.roll(-1, 0) - track.centreline).norm(dim=1)
    assert spacing.max().item() == pytest.approx(DRAWINGS[name].point_spacing, rel=0.02)
    assert spacing.min() > 0.95 * spacing.max()
    assert track.length == pytest.approx(spacing.sum().item(), rel=1e-5)


@pytest.mark.parametrize("name", ["oval", "paper", "serpentine"])
def test_no_turn_of_a_builtin_track_is_tighter_than_its_drawing_says(name: str):
    track, drawing = Track.load(name), DRAWINGS[name]
    bends = curvature(track.centreline.double().numpy())
    assert 1 / np.abs(bends).max() >= 0.98 * drawing.corner_radius
    assert 1 / np.abs(bends).max() <= 1.05 * drawing.corner_radius


def test_the_grand_prix_track_is_2_7_kilometres_long_with_a_straight_of_400_metres_and_a_hairpin():
    track = Track.load("grand_prix")
    bends = curvature(track.centreline.double().numpy())
    assert track.length == pytest.approx(2738, abs=5)
    assert 15 < 1 / np.abs(bends).max() < 18
    straight = np.abs(np.roll(bends, 75)[:200]) < 2e-3  # 150 m before the start line to 250 m after it
    assert straight.all()


@pytest.mark.parametrize("name", ["paper", "serpentine"])
def test_the_track_turns_both_ways(name: str):
    bends = curvature(Track.load(name).centreline.double().numpy())
    assert bends.max() > 0.05
    assert bends.min() < -0.05


def test_the_papers_track_has_eight_gates_and_is_about_230_metres_round():
    track = Track.load("paper")
    assert track.gate_count == 8
    assert track.gates.shape == (8, 2, 2)
    assert track.length == pytest.approx(230, rel=0.05)


@pytest.mark.parametrize("name", builtin_names())
def test_the_road_of_a_builtin_track_is_as_wide_as_drawn_everywhere(name: str):
    track, half = Track.load(name), DRAWINGS[name].width / 2
    for side in (track.left_wall, track.right_wall):
        across = torch.linalg.vector_norm(side - track.centreline, dim=1)
        torch.testing.assert_close(across, torch.full_like(across, half), atol=1e-4, rtol=0)
    middle = track.pose_at(torch.arange(0, track.length, 0.5))[:, :2].double().numpy()
    for side in (track.left_wall, track.right_wall):
        nearest = [ring(side).distance(LineString([point, point])) for point in middle]
        assert min(nearest) > half - 0.15  # between the points the road is a polygon
        assert max(nearest) < half + 0.15


@pytest.mark.parametrize("name", builtin_names())
def test_the_walls_of_a_builtin_track_never_cross_themselves_or_each_other(name: str):
    track = Track.load(name)
    left, right = ring(track.left_wall), ring(track.right_wall)
    assert left.is_simple
    assert right.is_simple
    assert left.distance(right) > DRAWINGS[name].width - 0.3
    assert right.envelope.contains(left)  # counter-clockwise: the right wall is outside


@pytest.mark.parametrize("name", builtin_names())
def test_the_walls_close_around_the_road(name: str):
    track = Track.load(name)
    count = len(track.centreline)
    assert track.walls.shape == (2 * count, 2, 2)
    for walls in (track.walls[:count], track.walls[count:]):
        assert torch.equal(walls[:, 1], walls[:, 0].roll(-1, 0))


# Gates


def assert_gates_span_the_road_and_face_forward(track: Track, tolerance: float) -> None:
    left, right = ring(track.left_wall), ring(track.right_wall)
    for (left_end, right_end), station in zip(track.gates.double().numpy(), track.gate_stations, strict=True):
        assert left.distance(LineString([left_end, left_end])) < 1e-3
        assert right.distance(LineString([right_end, right_end])) < 1e-3
        x, y, heading = track.pose_at(station[None])[0].double().numpy()
        assert LineString([left_end, right_end]).distance(LineString([(x, y), (x, y)])) < tolerance
        across = right_end - left_end
        forward = np.array([-across[1], across[0]]) / np.linalg.norm(across)
        assert forward @ (np.cos(heading), np.sin(heading)) > 0.9


@pytest.mark.parametrize("name", builtin_names())
def test_gates_span_from_wall_to_wall_at_their_stations_and_face_forward(name: str):
    assert_gates_span_the_road_and_face_forward(Track.load(name), tolerance=1e-3)


@pytest.mark.parametrize("name", builtin_names())
def test_the_last_gate_is_the_start_line(name: str):
    track = Track.load(name)
    expected = torch.stack([track.left_wall[0], track.right_wall[0]])
    torch.testing.assert_close(track.gates[-1], expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(track.pose_at(torch.zeros(1))[0, :2], track.centreline[0])


@pytest.mark.parametrize("spacing", [5.0, 10.0, 30.0, 60.0])
def test_gates_stand_about_as_far_apart_as_asked(spacing: float):
    track = Track.load("paper", gate_spacing=spacing)
    assert track.gate_count == round(track.length / spacing)
    gaps = track.gate_stations.diff(prepend=torch.zeros(1, dtype=torch.float64))
    torch.testing.assert_close(gaps, torch.full_like(gaps, track.length / track.gate_count))


def test_a_track_has_at_least_three_gates():
    assert Track.load("paper", gate_spacing=1e6).gate_count == 3


@pytest.mark.parametrize("spacing", [0.0, -30.0, 1e-9, float("nan"), "wide"])
def test_a_gate_spacing_that_is_no_distance_is_refused(spacing: object):
    with pytest.raises(TrackError, match=re.escape(f"track 'paper': gate_spacing is {spacing}; it must be")):
        Track.load("paper", gate_spacing=spacing)


# Stations


def test_poses_along_a_straight_are_those_worked_by_hand():
    track = straight_road_track()
    poses = track.pose_at(torch.tensor([0.0, 7.5, 199.0, track.length + 7.5, -track.length + 3.0]))
    torch.testing.assert_close(poses[:, 0], torch.tensor([0.0, 7.5, 199.0, 7.5, 3.0]), atol=1e-3, rtol=0)
    assert poses[:, 1:].abs().max() < 1e-3


def test_a_pose_at_a_corner_points_along_the_stretch_that_leaves_it(load_text):
    headings = load_text(HEADER + SQUARE).pose_at(torch.tensor([0.0, 40.0, 80.0, 120.0]))[:, 2]
    assert headings.tolist() == pytest.approx([0, np.pi / 2, np.pi, -np.pi / 2])


def test_the_station_of_a_point_on_the_centreline_is_found_again():
    track = Track.load("serpentine")
    stations = torch.rand(100, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * track.length
    found = track.station_near(track.pose_at(stations)[:, :2], stations - 10, stations + 10)
    torch.testing.assert_close(found, stations, atol=0.05, rtol=0)


# Centreline files


def assert_is_the_square(track: Track) -> None:
    """The left wall is 3 m and the right wall 2 m from the centreline, measured square to it."""
    assert track.length == 160.0
    assert track.centreline.tolist() == [[0, 0], [40, 0], [40, 40], [0, 40]]
    inward = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    np.testing.assert_allclose(track.left_wall.numpy(), track.centreline.numpy() + 3 * inward, atol=1e-5)
    np.testing.assert_allclose(track.right_wall.numpy(), track.centreline.numpy() - 2 * inward, atol=1e-5)


@pytest.mark.parametrize(
    "content",
    [
        HEADER + SQUARE,
        HEADER.removeprefix("# ") + SQUARE,
        "\ufeff" + HEADER + SQUARE,
        (HEADER + SQUARE).replace("\n", "\r\n"),
        (HEADER + SQUARE).replace("\n", "\r"),
        HEADER + SQUARE.rstrip("\n"),
        HEADER + SQUARE + "0,0,2,3\n",
        HEADER + SQUARE + "0.001,0,2,3\n",
        "\n" + HEADER + "\n" + SQUARE.replace("\n", "\n\n   \n,,,\n"),
        HEADER.upper() + SQUARE.replace(",", " , "),
        HEADER + SQUARE.replace("40", '"40"'),
        HEADER + SQUARE.replace("40", "+4.0E1"),
        HEADER.replace("\n", ",note\n") + SQUARE.replace("3\n", '3,"two\nlines, one cell"\n'),
        "# w_tr_left_m,y_m,x_m,w_tr_right_m\n3,0,0,2\n3,0,40,2\n3,40,40,2\n3,40,0,2\n",
        SQUARE,
        "\ufeff" + SQUARE.replace("\n", ",\r\n"),
        (HEADER + SQUARE).replace(",", ";"),
        (HEADER + SQUARE).replace(",", "\t"),
        (HEADER + SQUARE).replace(",", "  "),
        HEADER + SQUARE.replace(",", ";"),
        HEADER + SQUARE.replace(",", ";").replace("2;", "2,0;"),
        "# a circuit of ours, drawn by hand; 2024\n#\n" + HEADER + "# the points\n" + SQUARE + "# the end\n",
        "A circuit\n" + HEADER.removeprefix("# ") + SQUARE,
        "# a circuit of ours\n" + SQUARE,
        HEADER.replace(",", " , ").replace("# ", "#  ") + SQUARE,
        "X [m], Y [m], width right (m), Width-Left\n" + SQUARE,
        "# x_ref_m; y_ref_m; width_right_m; width_left_m; s_m\n" + SQUARE.replace("\n", ",0\n").replace(",", "; "),
        HEADER + SQUARE.replace("40,40,2,3\n", "40,40,2,3\n40,40,2,3\n40,40.001,9,9\n"),
        HEADER + SQUARE + "0,0,2,3\n0,0,2,3\n",
    ],
    ids=[
        "plain",
        "header without hash",
        "byte order mark",
        "windows lines",
        "old mac lines",
        "no newline at the end",
        "closing point repeated",
        "closing point nearly repeated",
        "blank lines",
        "upper case and spaces",
        "quoted numbers",
        "exponents",
        "another column",
        "columns in another order",
        "four columns without a header",
        "the same with an empty fifth one from Windows",
        "semicolons",
        "tabs",
        "blanks between columns",
        "a header with commas over semicolons",
        "decimal commas",
        "comments before and after the header",
        "a title",
        "a comment but no header",
        "blanks in the header",
        "other names and units",
        "names of the TUM's raceline tool",
        "repeated points",
        "the first point twice at the end",
    ],
)
def test_a_centreline_file_loads_however_it_is_written(load_text, content: str):
    track = load_text(content)
    assert track.name == "square.csv"
    assert_is_the_square(track)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("# x_m,y_m,w_tr_right_m\n0,0,2\n", "no column w_tr_left_m"),
        (
            SQUARE.replace("3\n", "3,1\n"),
            "there is no header, and line 1 has 5 columns; only four are taken for x_m, y_m",
        ),
        (
            "# a circuit\n" + SQUARE.replace("3\n", "3,1\n"),
            "the header in line 1 has no column x_m, y_m, .* has a circuit,",
        ),
        (
            "# s_m; x_m; y_m; psi_rad\n0;0;0;0\n",
            "header in line 1 has no column w_tr_right_m, w_tr_left_m; it has s_m, x_",
        ),
        (("a," * 10_000 + "\n") * 50, "the header in line 1 has no column x_m, .* it has a, a, a"),
        ("# " + "a," * 100_000 + "\n" + SQUARE.replace("3\n", "3,1\n"), "the header in line 1 has no column x_m"),
        ("# a\n" * 1001, "more than 100000 points or 1000 comments"),
        ('{"type": "FeatureCollection"}', "this is JSON or XML; name it .geojson, .xml or .xodr"),
        ('<?xml version="1.0"?>\n<params/>', "this is JSON or XML"),
        ("", "empty"),
        ("\n \n", "empty"),
        (HEADER, "0 points"),
        (HEADER + "0,0,2,3\n40,0,2,3\n", "2 points"),
        (HEADER + "0,0,2,3\n40,0,2,3\n0,0,2,3\n", "2 points"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,nan,2,3"), "line 4: y_m is nan; it must be a finite number"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,40,inf,3"), "line 4: w_tr_right_m is inf"),
        (HEADER + SQUARE.replace("40,40,2,3", "-inf,40,2,3"), "line 4: x_m is -inf"),
        (HEADER + SQUARE.replace("40,40,2,3", "1e999,40,2,3"), "line 4: x_m is 1e999"),
        (
            HEADER + SQUARE.replace("40,40,2,3", "5000000,40,2,3"),
            "line 4: x_m is 5000000; it must be .* at most 100000",
        ),
        (HEADER + SQUARE.replace("40,40,2,3", "40,40,-2,3"), "line 4: w_tr_right_m is -2.0 m; widths must be positive"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,40,2,0"), "line 4: w_tr_left_m is 0.0 m; widths must be positive"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,north,2,3"), "line 4: y_m is 'north'; it must be a number"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,4_0,2,3"), "line 4: y_m is '4_0'; it must be a number"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,40,2"), "line 4: w_tr_left_m is ''; it must be a number"),
        (HEADER + SQUARE.replace("40,40,2,3", "40,,2,3"), "line 4: y_m is ''; it must be a number"),
        (HEADER + "\n\n" + SQUARE.replace("40,40", "40,x"), "line 6: y_m is 'x'"),
        (HEADER + SQUARE.replace("40,40,2", '"4\n0",40,2'), r"line 4: x_m is '4\\n0'; it must be a number"),
        (HEADER + '"0\n",0,2,3\n40,y,2,3\n', "line 4: y_m is 'y'"),
        (HEADER + '0,0,2,3\n"40,0,2,3\n40,40,2,3\n', "line 3: x_m is '40,0"),
        (HEADER + "0,0,2,3\n40,40,2,3\n40,0,2,3\n0,40,2,3\n", "the centreline crosses itself at 0 m, where its two"),
        (HEADER + "0,0,2,3\n40,0,2,3\n80,0,2,3\n", "not closed: its last point is 80.00 m from its first"),
        (bytes(range(256)) * 4, "not a CSV text file"),
        (b"\x00" * 64, "no column x_m"),
        ((HEADER + SQUARE).encode("utf-16"), "not a CSV text file"),
        (HEADER + "9" * 200_000 + ",0,2,3\n", "not a CSV text file"),
    ],
)
def test_a_bad_file_is_refused_with_one_clear_error(load_text, content: str | bytes, says: str):
    with pytest.raises(TrackError, match=rf"^track 'square\.csv': .*{says}") as error:
        load_text(content)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def test_a_file_too_large_to_be_a_track_is_refused_unread(tmp_path: Path):
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate(17 * 2**20)
    with pytest.raises(TrackError, match=r"^track 'large.csv': the file is too large; .* 16777216 bytes$"):
        Track.load(path)


def test_an_endless_device_is_refused_too():
    with pytest.raises(TrackError, match=r"^track 'zero': this is not a regular file"):
        Track.load("/dev/zero")


def test_a_folder_is_refused_as_a_folder(tmp_path: Path):
    with pytest.raises(TrackError, match=re.escape(f"track '{tmp_path}': this is a folder")):
        Track.load(tmp_path)


@pytest.mark.parametrize(
    ("name", "close"),
    [
        ("nowhere.csv", ";"),
        ("Oval", "; did you mean oval?"),
        ("paper ", "; did you mean paper?"),
        ("a" * 5000, ";"),
        ("a\0b", ";"),
    ],
)
def test_a_name_of_neither_a_file_nor_a_builtin_track_is_answered_with_the_names_there_are(name: str, close: str):
    message = f"track '{name}': no file of this path and no built-in track of this name{close} the built-in ones"
    with pytest.raises(TrackError, match=re.escape(message)):
        Track.load(name)


def test_ten_thousand_points_load(load_text):
    angle = np.linspace(0, 2 * np.pi, 10_000, endpoint=False)
    rows = [f"{1000 * np.cos(a):.3f},{1000 * np.sin(a):.3f},5,5\n" for a in angle]
    track = load_text(HEADER + "".join(rows))
    assert track.length == pytest.approx(2000 * np.pi, rel=1e-4)


def test_neighbouring_points_of_a_far_off_track_stay_apart_in_float32():
    """The finest spacing at the largest coordinate that a file may have."""
    step, far = centreline.MIN_STEP, centreline.MAX_COORDINATE
    corners = np.array([[0, 0], [step, 0], [step, step], [0, step]])
    track = Track.from_centreline("far", Centreline(far - corners, np.ones(4), np.ones(4)))
    assert (track.centreline.roll(-1, 0) - track.centreline).norm(dim=1).min() > 0


def test_a_triangle_with_walls_wider_than_itself_still_simulates(load_text):
    track = load_text(HEADER + "0,0,50,50\n10,0,50,50\n0,10,50,50\n")
    simulator = Simulator(track, Vehicle(), Sensor(rays=1))
    stations = torch.linspace(0, track.length, 10)
    outcome = simulator.step(simulator.start(stations), steer(torch.zeros(10, dtype=torch.int64)))
    assert ((outcome.ranges >= 0) & (outcome.ranges <= 20)).all()
    assert simulator.progress(outcome.cars, stations).isfinite().all()


# Real circuits


@pytest.mark.parametrize("name", CIRCUITS)
def test_a_real_circuit_loads_with_gates_across_its_road(real_circuits: Path, name: str):
    track = Track.load(real_circuits / f"{name}.csv")
    assert track.walls.isfinite().all()
    assert track.gate_count == round(track.length / 30)
    assert_gates_span_the_road_and_face_forward(track, tolerance=0.1)


@pytest.mark.parametrize("name", CIRCUITS)
def test_the_walls_of_a_real_circuit_never_cross_and_none_is_without_length(real_circuits: Path, name: str):
    track = Track.load(real_circuits / f"{name}.csv")
    left, right = track.walls[: len(track.walls) // 2], track.walls[len(track.walls) // 2 :]
    assert len(track.walls) == 2 * len(track.centreline)  # none of these circuits folds
    assert (track.walls[:, 0] - track.walls[:, 1]).norm(dim=1).min() > 0
    for side, walls in ((track.left_wall, left), (track.right_wall, right)):
        assert ring(side).is_simple
        assert torch.equal(walls[:, 0], side)
    assert not ring(track.left_wall).intersects(ring(track.right_wall))
    assert inspect_track(track).faults == ()


# Beside the road


@pytest.mark.parametrize("name", builtin_names())
def test_a_wall_stands_beside_the_middle_of_its_segment(name: str):
    track = Track.load(name)
    assert track.wall_stations.dtype == torch.float64
    middle = track.pose_at(track.wall_stations)[:, :2]
    distance = (track.walls.mean(dim=1) - middle).norm(dim=1)
    torch.testing.assert_close(distance, torch.full_like(distance, DRAWINGS[name].width / 2), atol=0.12, rtol=0)


def test_the_room_beside_a_straight_is_the_widths_of_the_file(load_text):
    track = load_text(HEADER + SQUARE)
    room = track.clearance_at(torch.tensor([20.0, 20.0 + track.length, 60.0]))
    assert room.dtype == torch.float64
    np.testing.assert_allclose(room.numpy(), [[3, 2]] * 3, atol=1e-5)


@pytest.mark.parametrize("name", builtin_names())
def test_the_room_of_a_builtin_track_is_half_its_width_everywhere(name: str):
    room = Track.load(name).clearance_at(torch.arange(0, 200, 0.7))
    torch.testing.assert_close(room, torch.full_like(room, DRAWINGS[name].width / 2), atol=0.1, rtol=0)


# The same road otherwise


def test_a_mirrored_track_turns_right_where_the_track_turns_left():
    track, mirrored = Track.load("serpentine"), Track.load("serpentine").mirrored()
    assert mirrored.name == "serpentine-mirrored"
    flip = torch.tensor([1.0, -1.0])
    bends, mirrored_bends = (curvature(t.centreline.double().numpy()) for t in (track, mirrored))
    np.testing.assert_allclose(mirrored_bends, -bends, atol=1e-9)
    assert torch.equal(mirrored.left_wall, track.right_wall * flip)
    assert torch.equal(mirrored.gates, track.gates.flip(1) * flip)
    assert mirrored.length == track.length
    torch.testing.assert_close(
        mirrored.clearance_at(torch.tensor([50.0])), track.clearance_at(torch.tensor([50.0])).flip(1)
    )


def test_a_reversed_track_has_the_same_gates_in_reverse_order_and_the_same_start_line():
    track, turned = Track.load("serpentine"), Track.load("serpentine").reversed()
    assert turned.name == "serpentine-reversed"
    assert turned.length == pytest.approx(track.length)
    torch.testing.assert_close(turned.gates[-1], track.gates[-1].flip(0))
    torch.testing.assert_close(turned.gates[:-1], track.gates[:-1].flip(0).flip(1), atol=1e-4, rtol=0)
    stations = torch.arange(1.0, track.length, 7.3, dtype=torch.float64)
    there, back = track.pose_at(stations), turned.pose_at(track.length - stations)
    torch.testing.assert_close(back[:, :2], there[:, :2], atol=1e-4, rtol=0)
    assert (torch.cos(back[:, 2] - there[:, 2]) < -0.999).all()
    torch.testing.assert_close(turned.clearance_at(track.length - stations), track.clearance_at(stations).flip(1))


@pytest.mark.parametrize("change", [Track.mirrored, Track.reversed])
def test_mirrored_or_reversed_twice_a_track_is_itself(change):
    track = Track.load("paper")
    again = change(change(track))
    for side in ("centreline", "left_wall", "right_wall"):
        assert torch.equal(getattr(again, side), getattr(track, side))


def test_mirrored_and_reversed_tracks_have_no_faults():
    for change in (Track.mirrored, Track.reversed):
        assert_gates_span_the_road_and_face_forward(change(Track.load("paper")), tolerance=1e-3)
        assert inspect_track(change(Track.load("paper"))).faults == ()


def test_the_plain_values_are_the_tensors_to_the_last_bit():
    track = Track.load("serpentine")
    plain = json.loads(json.dumps(track.as_dict()))
    for name in ("centreline", "walls", "gates"):
        assert torch.equal(torch.tensor(plain[name], dtype=torch.float32), getattr(track, name))
    assert len(json.dumps(plain["walls"])) < 0.7 * len(json.dumps(track.walls.tolist()))
