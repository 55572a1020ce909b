"""OpenDRIVE's closed roads and rings of roads."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.special import fresnel

from carrl.errors import TrackError
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track

RIGHT = '<right><lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right>'
LEFT = RIGHT.replace("right>", "left>").replace("-1", "1")
LINE, ARC = "<line/>", '<arc curvature="0.02"/>'
HALF = 50 * math.pi
STADIUM = [(0, 0, 0, 100, LINE), (100, 0, 0, HALF, ARC), (100, 100, math.pi, 100, LINE), (0, 100, math.pi, HALF, ARC)]


def geometry(x: float, y: float, heading: float, length: float, shape: str) -> str:
    return f'<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'


def road(*geometries: tuple, lanes: str = RIGHT, link: str = "", road_id: object = 1, more: str = "") -> str:
    plan = "".join(geometry(*each) for each in geometries)
    sections = lanes if "laneSection" in lanes else f'<laneSection s="0">{lanes}</laneSection>'
    return (
        f'<road id="{road_id}" junction="-1" {more}><link>{link}</link><planView>{plan}</planView>'
        f"<lanes>{sections}</lanes></road>"
    )


def link(name: str, to: object, contact: str, kind: str = "road") -> str:
    return f'<{name} elementType="{kind}" elementId="{to}" contactPoint="{contact}"/>'


@pytest.fixture
def read(tmp_path: Path):
    def read(*roads: str, **options) -> list[Track]:
        path = tmp_path / "own.xodr"
        path.write_text(f"<OpenDRIVE>{''.join(roads)}</OpenDRIVE>")
        return Track.load_all(path, **options)

    return read


def test_a_closed_road_is_a_circuit_in_the_middle_of_its_lanes(read, tmp_path: Path):
    (track,) = read(road(*STADIUM))
    assert track.name == "own.xodr"
    assert track.centreline[0].tolist() == [0, -2]
    assert track.length == pytest.approx(200 + 2 * 52 * math.pi, abs=0.05)  # lanes on the outside of the line
    report = inspect_track(track)
    assert (report.width_min, report.width_max) == pytest.approx((4, 4), abs=1e-3)
    assert report.least_radius_left == pytest.approx(52, abs=0.2)
    assert report.faults == ()
    (tmp_path / "own.xml").write_bytes((tmp_path / "own.xodr").read_bytes())
    assert Track.load(tmp_path / "own.xml").length == track.length


def test_lanes_on_both_sides_are_one_road_and_those_beyond_are_left_out(read):
    shoulder = '<lane id="-2" type="shoulder"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane></right>'
    (track,) = read(road(*STADIUM, lanes=LEFT + RIGHT.replace("</right>", shoulder)))
    assert track.centreline[0].tolist() == [0, 0]
    assert inspect_track(track).width_max == pytest.approx(8, abs=1e-3)


def test_traffic_on_the_left_of_the_line_runs_against_it(read):
    (track,), (back,) = read(road(*STADIUM, lanes=LEFT)), read(road(*STADIUM, lanes=LEFT), direction="counterclockwise")
    assert inspect_track(track).least_radius_left is None
    assert inspect_track(back).least_radius_right is None
    (left_hand,) = read(road(*STADIUM, lanes=LEFT, more='rule="LHT"'))
    assert inspect_track(left_hand).least_radius_right is None


def test_widths_and_offsets_are_polynomials_from_where_they_begin(read):
    widens = '<width sOffset="0" a="4" b="0" c="0" d="0"/><width sOffset="50" a="4" b="0.02" c="0" d="0"/>'
    narrow = RIGHT.replace('<width sOffset="0" a="4" b="0" c="0" d="0"/>', widens)
    sections = (
        '<laneOffset s="0" a="1" b="0" c="0" d="0"/>'
        f'<laneSection s="0">{narrow}</laneSection><laneSection s="100">{RIGHT}</laneSection>'
    )
    (track,) = read(road(*STADIUM, lanes=sections))
    assert track.left_wall[0].tolist() == [0, 1]
    across = (track.left_wall - track.right_wall).norm(dim=1)
    assert across[15].item() == pytest.approx(4 + 0.02 * 25, abs=1e-3)  # 75 m on
    assert across[30:].max().item() == pytest.approx(4, abs=1e-3)


def test_a_polynomial_is_not_in_force_before_it_begins(read):
    offset = '<laneOffset s="300" a="0" b="0.005" c="0" d="0"/>'
    begun = '<laneOffset s="0" a="0" b="0" c="0" d="0"/>' + offset
    section = f'<laneSection s="0">{RIGHT}</laneSection>'
    late, whole = read(road(*STADIUM, lanes=offset + section)), read(road(*STADIUM, lanes=begun + section))
    np.testing.assert_array_equal(late[0].centreline, whole[0].centreline)
    with pytest.raises(TrackError, match="its lanes have no width somewhere"):
        read(road(*STADIUM, lanes=RIGHT.replace('sOffset="0"', 'sOffset="300"').replace('b="0"', 'b="0.01"')))


def test_sections_and_geometries_are_taken_in_the_order_of_their_s(read):
    wide = RIGHT.replace('a="4"', 'a="7"')
    sections = [f'<laneSection s="0">{RIGHT}</laneSection>', f'<laneSection s="150">{wide}</laneSection>']
    usual, swapped = (read(road(*STADIUM, lanes="".join(each)))[0] for each in (sections, sections[::-1]))
    assert inspect_track(usual).width_max == pytest.approx(7, abs=0.01)
    np.testing.assert_array_equal(swapped.left_wall, usual.left_wall)
    other = "".join(geometry(*STADIUM[at]).replace('s="0"', f's="{at}"') for at in (2, 3, 0, 1))
    (moved,) = read(road(*STADIUM).replace("".join(geometry(*each) for each in STADIUM), other))
    np.testing.assert_array_equal(moved.centreline, read(road(*STADIUM))[0].centreline)


def test_a_note_of_another_tool_before_a_shape_is_none(read):
    (noted,) = read(road(*STADIUM).replace(LINE, '<userData code="x"/><line/>'))
    assert noted.length == read(road(*STADIUM))[0].length


def test_lanes_that_are_told_of_one_side_alone_are_refused_and_do_not_take_those_of_the_other(read):
    single = f'<laneSection s="100" singleSide="true">{LEFT}</laneSection>'
    with pytest.raises(TrackError, match="a laneSection has lanes of a singleSide; write those of both sides in each"):
        read(road(*STADIUM, lanes=f'<laneSection s="0">{LEFT}{RIGHT}</laneSection>{single}'))


def test_a_ring_of_roads_may_be_linked_end_to_end_in_any_direction(read):
    first, second, third, fourth = STADIUM
    turned = (0, 100, 0, 100, LINE)  # the third, drawn the other way
    roads = [
        road(first, lanes=LEFT + RIGHT, link=link("successor", "b", "start"), road_id="a"),
        road(second, lanes=LEFT + RIGHT, link=link("successor", "c", "end"), road_id="b"),
        road(turned, lanes=LEFT + RIGHT, link=link("predecessor", "d", "start"), road_id="c"),
        road(fourth, lanes=LEFT + RIGHT, link=link("successor", "a", "start"), road_id="d"),
    ]
    (track,), (whole,) = read(*roads), read(road(first, second, third, fourth, lanes=LEFT + RIGHT))
    np.testing.assert_allclose(track.left_wall, whole.left_wall, atol=1e-4)
    np.testing.assert_allclose(track.right_wall, whole.right_wall, atol=1e-4)


def test_one_of_many_circuits_is_chosen_by_its_first_road(read, tmp_path: Path):
    far = [(x + 500, y, *rest) for x, y, *rest in STADIUM]
    roads = road(*STADIUM, road_id=7), road(*far, road_id=8)
    assert [track.name for track in read(*roads)] == ["own.xodr/7", "own.xodr/8"]
    assert Track.load(tmp_path / "own.xodr", circuit="8").centreline[0].tolist() == [500, -2]
    with pytest.raises(TrackError, match="there is no circuit '9' in it; it has 7, 8"):
        Track.load(tmp_path / "own.xodr", circuit="9")


def test_a_spiral_is_that_of_fresnel(read):
    """Four corners, each a clothoid to a curvature of 0.02/m and the same one backwards from there."""
    peak, length = 0.02, 25 * math.pi
    turn = peak * length / 2  # 45 degrees
    scale = math.sqrt(math.pi * length / peak)
    to_left, ahead = (scale * value for value in fresnel(length / scale))
    there, back = f'<spiral curvStart="0" curvEnd="{peak}"/>', f'<spiral curvStart="{peak}" curvEnd="0"/>'

    def moved(place: complex, heading: float, u: float, v: float) -> complex:
        return place + complex(u, v) * complex(math.cos(heading), math.sin(heading))

    place, pieces = 0j, []
    for corner in range(4):
        heading = corner * 2 * turn
        middle = moved(place, heading, ahead, to_left)
        pieces += [
            (place.real, place.imag, heading, length, there),
            (middle.real, middle.imag, heading + turn, length, back),
        ]
        place = moved(middle, heading + 2 * turn, ahead, -to_left)
    assert abs(place) < 1e-9
    (track,) = read(road(*pieces))
    assert inspect_track(track).faults == ()
    assert inspect_track(track).least_radius_left == pytest.approx(1 / peak + 2, rel=0.02)
    assert track.length == pytest.approx(8 * length + 2 * 2 * math.pi, abs=0.1)


@pytest.mark.parametrize("p_range", ["normalized", "arcLength"])
def test_parametric_polynomials_run_over_0_to_1_or_over_the_length(read, p_range: str):
    unit = 100 if p_range == "normalized" else 1
    zeros = " ".join(f'{name}="0"' for name in ("aU", "cU", "dU", "aV", "bV", "cV", "dV"))
    straight = f'<paramPoly3 pRange="{p_range}" bU="{unit}" {zeros}/>'
    pieces = [(*each[:4], straight if each[4] == LINE else each[4]) for each in STADIUM]
    (track,) = read(road(*pieces))
    assert track.length == pytest.approx(200 + 2 * 52 * math.pi, abs=0.05)


def test_a_road_far_from_the_origin_of_its_grid_is_moved_there(read):
    far = [(x + 4_500_000, y + 5_300_000, *rest) for x, y, *rest in STADIUM]
    (track,) = read(road(*far))
    assert track.centreline[0].abs().max() < 10
    assert track.length == pytest.approx(200 + 2 * 52 * math.pi, abs=0.05)


@pytest.mark.parametrize(
    ("roads", "says"),
    [
        ([], "there is no road in it; a circuit is a closed road, or a ring of roads linked without a junction"),
        ([road(*STADIUM[:3])], "road '1' ends; a circuit is"),
        ([road(*STADIUM[:3], link=link("successor", 5, "start", "junction"))], "road '1' runs into a junction"),
        ([road(*STADIUM[:3], link=link("successor", 5, "start"))], "road '1' runs into no road"),
        (
            [road(*STADIUM[:3], link=link("successor", 1, "start"))],
            "a road ends 104.00 m from where the next one begins",
        ),
        ([road(*STADIUM[:1], *STADIUM[2:])], "road '1': its geometry jumps at 100.0 m"),
        ([road()], "road '1': it has no geometry"),
        ([road(*STADIUM, lanes="")], "a laneSection has no lane to drive on, of a type such as driving"),
        ([road(*STADIUM, lanes=RIGHT.replace("driving", "sidewalk"))], "a laneSection has no lane to drive on"),
        ([road(*STADIUM, lanes=RIGHT.replace("width", "border"))], "a lane has a border and no width"),
        ([road(*STADIUM, lanes=RIGHT.replace('"4"', '"0"'))], "its lanes have no width somewhere"),
        ([road(*STADIUM, lanes=RIGHT.replace('"4"', '"1e7"'))], "a width or offset is more than 100000 m"),
        ([road(*STADIUM, lanes=RIGHT.replace('"4"', '"four"'))], "a of 'width' is 'four'; it must be a number"),
        ([road((0, 0, 0, 100, "<poly3/>"))], "its geometry is 'poly3'; CarRL reads line, arc, spiral and paramPoly3"),
        ([road((0, 0, 0, math.nan, LINE))], "length of 'geometry' is 'nan'; it must be at most 100000000"),
        ([road((0, 0, 0, -1, LINE))], "a length is -1 m"),
        ([road((0, 0, 0, 1e5, LINE), (0, 0, 0, 1e5, LINE))], "it has more than 100000 points, 10000 parts or 100000 m"),
    ],
)
def test_what_is_no_circuit_is_refused_in_one_sentence(read, roads: list[str], says: str):
    with pytest.raises(TrackError, match=re.escape(says)) as refusal:
        read(*roads)
    assert str(refusal.value).startswith("track 'own.xodr': ")


def test_other_xml_is_no_opendrive(tmp_path: Path):
    path = tmp_path / "own.xodr"
    path.write_text("<params/>")
    with pytest.raises(TrackError, match="this is no OpenDRIVE: its outermost element is 'params'"):
        Track.load(path)
