"""Racelines and the files of other tools around them."""

import numpy as np
import pytest
import torch

from carrl.errors import TrackError
from carrl.tracks.track import Track

ANGLE = np.linspace(0, 2 * np.pi, 60, endpoint=False)
CIRCLE = 50 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)
TUM_HEADER = "# 8288b625-90b8\n# 603fd3987364\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n"


def raceline(radius: float = 50.0) -> str:
    rows = [f"{i * 5}; {x * radius / 50:.4f}; {y * radius / 50:.4f}; 0; 0.02; 30; 0" for i, (x, y) in enumerate(CIRCLE)]
    return TUM_HEADER + "\n".join([*rows, rows[0]])


def centreline() -> str:
    return "# x_m, y_m, w_tr_right_m, w_tr_left_m\n" + "\n".join(f"{x:.4f}, {y:.4f}, 4.0, 3.0" for x, y in CIRCLE)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "Ring_centerline.csv").write_text(centreline())
    (tmp_path / "Ring_raceline.csv").write_text(raceline(49.0))
    return tmp_path


def test_a_raceline_with_a_width_given_is_the_middle_of_a_road_and_its_reference_line(folder):
    track = Track.load(folder / "Ring_raceline.csv", width=8.0)
    torch.testing.assert_close(track.left_wall.norm(dim=1), torch.full((60,), 45.0), atol=0.1, rtol=0)
    torch.testing.assert_close(track.right_wall.norm(dim=1), torch.full((60,), 53.0), atol=0.1, rtol=0)
    assert track.reference_line is not None
    torch.testing.assert_close(track.reference_line, track.centreline)
    assert track.notes == ("a line without widths, taken for the middle of a road 8 m wide",)


def test_a_raceline_without_a_width_is_refused_with_the_remedy(folder):
    with pytest.raises(TrackError, match=r"no column w_tr_right_m, w_tr_left_m; .*, give track\.width$"):
        Track.load(folder / "Ring_raceline.csv")
    (folder / "line.csv").write_text("# x_m,y_m\n" + "\n".join(f"{x},{y}" for x, y in CIRCLE))
    with pytest.raises(TrackError, match=r"give track\.width$"):
        Track.load(folder / "line.csv")
    assert Track.load(folder / "line.csv", width=6).length == pytest.approx(313.9, abs=0.5)


@pytest.mark.parametrize("width", [0, -3, float("nan"), True, "8"])
def test_a_width_that_is_none_is_refused(folder, width):
    with pytest.raises(
        TrackError, match=r"^track 'Ring_raceline.csv': width is .*; it must be a number of metres above 0"
    ):
        Track.load(folder / "Ring_raceline.csv", width=width)


def test_a_width_for_a_road_that_has_one_is_refused_and_not_ignored(folder):
    with pytest.raises(TrackError, match="width is 8, but this file has widths of its own"):
        Track.load(folder / "Ring_centerline.csv", width=8)
    with pytest.raises(TrackError, match="track 'oval': it takes no width"):
        Track.load("oval", width=8)


def test_a_raceline_beside_a_centreline_is_kept_with_the_track(folder):
    track = Track.load(folder / "Ring_centerline.csv", scale=2.0)
    assert track.notes == ("reference line from Ring_raceline.csv",)
    torch.testing.assert_close(track.reference_line.norm(dim=1), torch.full((60,), 98.0), atol=0.01, rtol=0)
    backwards = track.reversed()
    torch.testing.assert_close(backwards.reference_line[1], track.reference_line[-1])
    torch.testing.assert_close(track.mirrored().reference_line[:, 1], -track.reference_line[:, 1])


def test_the_racelines_of_tums_database_are_found_in_their_own_folder(tmp_path):
    for name, content in (("tracks", centreline()), ("racelines", raceline())):
        (tmp_path / name).mkdir()
        (tmp_path / name / "Ring.csv").write_text(content)
    assert Track.load(tmp_path / "tracks" / "Ring.csv").notes == ("reference line from Ring.csv",)


def test_a_raceline_beside_that_cannot_be_read_is_said_to_be_left_out(folder):
    (folder / "Ring_raceline.csv").write_text("nothing")
    track = Track.load(folder / "Ring_centerline.csv")
    assert track.reference_line is None
    assert track.notes == ("no reference line, since Ring_raceline.csv beside it cannot be read as one",)


def test_tums_local_planner_file_has_road_and_raceline(tmp_path):
    header = "x_ref_m; y_ref_m; width_right_m; width_left_m; x_normvec_m; y_normvec_m; alpha_m; s_racetraj_m; vx_mps"
    rows = [f"{x}; {y}; 4; 3; {x / 50}; {y / 50}; -1.5; 0; 30" for x, y in CIRCLE.tolist()]
    path = tmp_path / "ltpl.csv"
    path.write_text("\n".join(["# an id", f"# {header}", *rows]))
    track = Track.load(path)
    torch.testing.assert_close(track.reference_line.norm(dim=1), torch.full((60,), 48.5))
    torch.testing.assert_close(track.right_wall.norm(dim=1), torch.full((60,), 54.0))


def test_four_columns_without_a_header_are_said_to_be_read_as_such(tmp_path):
    (tmp_path / "bare.csv").write_text("\n".join(f"{x},{y},4,3" for x, y in CIRCLE.tolist()))
    note = "four columns without a header, read as x_m, y_m, w_tr_right_m, w_tr_left_m"
    assert Track.load(tmp_path / "bare.csv").notes == (note,)


OTHER_NAMES = (
    "x_cm,y_cm,w_tr_right_cm,w_tr_left_cm",
    "x [ft],y [ft],right [ft],left [ft]",
    "xl,yl,xr,yr",
    "s,psi,kappa,v",
)


@pytest.mark.parametrize("header", [*OTHER_NAMES, *(f"# {names}" for names in OTHER_NAMES)])
def test_columns_of_other_names_or_units_are_not_taken_for_those_of_a_road(tmp_path, header):
    path = tmp_path / "other.csv"
    path.write_text(f"# by some tool of four words\n{header}\n" + "\n".join(f"{x},{y},4,3" for x, y in CIRCLE))
    with pytest.raises(TrackError, match=r"the header in line 2 has no column x_m, y_m, w_tr_right_m, w_tr_left_m; "):
        Track.load(path)


def test_a_line_of_longitudes_and_latitudes_is_no_line_in_metres(tmp_path):
    path = tmp_path / "degrees.csv"
    path.write_text("lon,lat\n" + "\n".join(f"{x},{y}" for x, y in CIRCLE))
    with pytest.raises(TrackError, match="the header in line 1 has no column x_m"):
        Track.load(path, width=8)


@pytest.mark.parametrize("comment", ["# my own race track", "# made by hand", "Title"])
def test_words_above_four_columns_are_no_header(tmp_path, comment):
    path = tmp_path / "plain.csv"
    rows = "\n".join(f"{x},{y},4,3" for x, y in CIRCLE)
    path.write_text(f"{comment}\n{rows}\n# by me, by hand, in May, at home")
    assert Track.load(path).notes == ("four columns without a header, read as x_m, y_m, w_tr_right_m, w_tr_left_m",)


def test_a_width_does_not_replace_those_of_a_file_that_are_bad_or_of_one_side(tmp_path):
    path = tmp_path / "road.csv"
    path.write_text("x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(f"{x},{y},4,{y}" for x, y in CIRCLE))
    with pytest.raises(TrackError, match=r"line 2: w_tr_left_m is 0\.0 m; widths must be positive$"):
        Track.load(path, width=8)
    path.write_text("x_m,y_m,w_tr_right_m\n" + "\n".join(f"{x},{y},4" for x, y in CIRCLE))
    with pytest.raises(TrackError, match=r"has no column w_tr_left_m; .*'$"):
        Track.load(path, width=8)
