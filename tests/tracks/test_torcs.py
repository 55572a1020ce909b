"""Tracks of TORCS: our own small files, and all those of Debian's torcs-data where it can be had."""

import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from carrl.errors import TrackError
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track

PACKAGE = "torcs-data"
MAIN = '<attnum name="width" val="10"/><attnum name="profil steps length" val="4"/>'
PUBLISHED = {  # as TORCS shows them and papers print them, m
    "road/g-track-1": 2057.56,
    "road/aalborg": 2587.54,
    "road/g-track-2": 3185.83,
    "road/g-track-3": 2843.10,
    "road/forza": 5784.10,
    "road/ruudskogen": 3274.20,
    "road/corkscrew": 3608.45,
}


def number(name: str, value: object, unit: str = "") -> str:
    of_unit = f' unit="{unit}"' if unit else ""
    return f'<attnum name="{name}"{of_unit} val="{value}"/>'


def straight(length: float = 100, inside: str = "") -> str:
    return f'<section name="line"><attstr name="type" val="str"/>{number("lg", length, "m")}{inside}</section>'


def curve(kind: str, radius: float, degrees: float, inside: str = "") -> str:
    values = number("radius", radius) + number("arc", degrees, "deg")
    return f'<section name="curve"><attstr name="type" val="{kind}"/>{values}{inside}</section>'


def xml(*segments: str, main: str = MAIN, spelling: str = "Track Segments", head: str = "") -> bytes:
    track = f'{main}<section name="{spelling}">{"".join(segments)}</section>'
    return f'<?xml version="1.0"?>\n{head}<params><section name="Main Track">{track}</section></params>'.encode()


OVAL = (straight(), curve("lft", 40, 180), straight(), curve("lft", 40, 180))


@pytest.fixture
def read(tmp_path: Path):
    def read(content: bytes, **options) -> Track:
        path = tmp_path / "own.xml"
        path.write_bytes(content)
        return Track.load(path, **options)

    return read


def widths(track: Track) -> np.ndarray:
    return (track.left_wall - track.right_wall).norm(dim=1).numpy()


def test_an_oval_has_the_length_of_its_segments_and_walls_at_half_the_width(read):
    track = read(xml(*OVAL))
    assert track.name == "own.xml"
    assert track.length == pytest.approx(200 + 80 * math.pi, abs=0.02)
    assert track.centreline[0].tolist() == [0, 0]
    assert track.pose_at(track.gate_stations[:1] * 0)[0, 2].item() == pytest.approx(0, abs=0.05)
    np.testing.assert_allclose(widths(track), 10, atol=1e-4)
    assert inspect_track(track).least_radius_left == pytest.approx(40, abs=0.1)
    assert inspect_track(track).faults == ()


def test_curves_to_the_right_turn_clockwise(read):
    report = inspect_track(read(xml(straight(), curve("rgt", 40, 180), straight(), curve("rgt", 40, 180))))
    assert report.least_radius_left is None
    assert report.least_radius_right == pytest.approx(40, abs=0.1)


def test_the_other_way_round_begins_at_the_same_line(read):
    track, back = read(xml(*OVAL)), read(xml(*OVAL), direction="clockwise")
    assert back.centreline[0].tolist() == [0, 0]
    assert back.centreline[1].tolist() == track.centreline[-1].tolist()
    assert inspect_track(back).least_radius_left is None


def test_gates_stand_as_far_apart_as_is_wished(read):
    assert read(xml(*OVAL), gate_spacing=10.0).gate_count == 45


@pytest.mark.parametrize(
    "arc",
    [number("arc", 180, "deg"), number("arc", math.pi), number("arc", math.pi, "rad")],
    ids=["deg", "none", "rad"],
)
def test_an_arc_without_a_unit_is_in_radians(read, arc: str):
    bend = f'<section name="curve"><attstr name="type" val="lft"/>{number("radius", 4000, "cm")}{arc}</section>'
    track = read(xml(straight(), bend, straight(), bend))
    assert track.length == pytest.approx(200 + 80 * math.pi, abs=0.02)


def test_a_foot_is_that_of_torcs(read):
    feet = straight().replace('unit="m" val="100"', 'unit="ft" val="1000"')
    track = read(xml(feet, curve("lft", 40, 180), feet, curve("lft", 40, 180)))
    assert track.length == pytest.approx(2 * 304.801 + 80 * math.pi, abs=0.02)


# The end radius


def test_a_curve_of_one_step_keeps_its_first_radius_over_the_length_of_the_mean_one(read):
    """Radius 50, end radius 100, arc 90 turn 135 degrees, so 225 more close the circle."""
    one_step = number("end radius", 100)
    track = read(xml(curve("lft", 50, 90, one_step), curve("lft", 50, 225), main=number("width", 10)))
    assert track.length == pytest.approx(100 * math.pi, abs=0.02)
    np.testing.assert_allclose((track.centreline - track.centreline.new_tensor([0, 50])).norm(dim=1), 50, atol=1e-3)


@pytest.mark.parametrize(
    ("profile", "of_track"),
    [(number("profil steps", 4), ""), (number("profil steps length", 39), ""), ("", number("profil steps length", 39))],
    ids=["count", "length", "of the track"],  # 117.8 m / 39 m + 1 = 4
)
def test_the_radius_grows_by_the_steps_of_the_profile_which_are_stretched_to_make_the_arc(
    read, profile: str, of_track: str
):
    there = curve("lft", 50, 90, number("end radius", 100) + profile)
    back = curve("lft", 100, 90, number("end radius", 50) + profile)
    track = read(xml(there, back, there, back, main=number("width", 10) + of_track))
    radii = (50, 50 + 50 / 3, 50 + 100 / 3, 100)
    step = math.pi / 2 / sum(1 / radius for radius in radii)
    assert track.length == pytest.approx(16 * step, abs=0.05)
    assert inspect_track(track).least_radius_left == pytest.approx(50, abs=0.2)


def test_a_linear_profile_is_one_step(read):
    linear = number("profil steps", 4) + '<attstr name="profil" val="linear"/>'
    there = curve("lft", 50, 90, number("end radius", 100) + linear)
    back = curve("lft", 100, 90, number("end radius", 50) + linear)
    with pytest.raises(TrackError, match=r"after 405\.0 degrees of turning"):  # 135 and 67.5 degrees, twice
        read(xml(there, back, there, back))


# Beside the road


def side(name: str, **values: object) -> str:
    inside = "".join(
        f'<attstr name="{key}" val="{value}"/>' if isinstance(value, str) else number(key.replace("_", " "), value)
        for key, value in values.items()
    )
    return f'<section name="{name}">{inside}</section>'


def test_barriers_stand_beyond_sides_that_grow_along_a_segment_and_stay_as_they_were(read):
    main = MAIN + side("Left Side", width=2.0) + side("Right Side", width=3.0)
    grows = straight(100, side("Left Side", end_width=12.0))
    track = read(xml(grows, *OVAL[1:], main=main), walls="barriers")
    left = (track.left_wall - track.centreline).norm(dim=1)
    assert left[0].item() == pytest.approx(7, abs=1e-3)
    assert left[10].item() == pytest.approx(7 + 10 / 2, abs=1e-3)  # 50 m on
    np.testing.assert_allclose(left[20:], 17, atol=1e-3)
    np.testing.assert_allclose((track.right_wall - track.centreline).norm(dim=1), 8, atol=1e-3)
    np.testing.assert_allclose(widths(read(xml(grows, *OVAL[1:], main=main))), 10, atol=1e-3)


def test_a_border_is_driven_on_unless_it_is_a_wall(read):
    main = MAIN + side("Left Side", width=4.0) + side("Left Border", width=1.0, style="curb")
    assert widths(read(xml(*OVAL, main=main), walls="barriers")).max() == pytest.approx(15, abs=1e-3)
    walled = main.replace("curb", "wall")
    np.testing.assert_allclose(widths(read(xml(*OVAL, main=walled), walls="barriers")), 10, atol=1e-3)


def test_the_older_spelling_is_read_as_well(read):
    main = MAIN + number("lside width", 2.0) + number("rborder width", 0.5)
    grows = straight(100, number("lside end width", 12.0))
    track = read(xml(grows, *OVAL[1:], main=main, spelling="segments"), walls="barriers")
    assert track.length == pytest.approx(200 + 80 * math.pi, abs=0.02)
    assert widths(track).max() == pytest.approx(5 + 12 + 5.5, abs=1e-3)


# XML


def test_external_entities_stand_for_nothing_and_no_file_is_read(read, tmp_path: Path):
    (tmp_path / "surfaces.xml").write_text("<broken")
    head = '<!DOCTYPE params SYSTEM "none.dtd" [<!ENTITY shared SYSTEM "surfaces.xml">]>'
    assert read(xml(*OVAL, head=head).replace(b"<section", b"&shared;<section", 1)).length > 400


def test_entities_that_grow_are_refused(read):
    lol = '<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">'
    with pytest.raises(TrackError, match="the entity 'a' is declared in the file; write out what it stands for"):
        read(xml(*OVAL, head=f"<!DOCTYPE params [{lol}]>"))


def test_bytes_that_are_no_utf_8_are_read_in_latin_1(read):
    assert read(xml(*OVAL).replace(b"<params", b"<!-- Andr\xe9 --><params")).length > 400


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"<params>", "line 1: this is not well-formed XML: no element found"),
        (b"\x00\xff", "this is not well-formed XML"),
        (b"<?xml version='1.0' encoding='utf-7'?><params/>", "the encoding of this XML is not read"),
        (b"<html/>", "this XML is 'html'; CarRL reads params, as of TORCS, and OpenDRIVE"),
        (b"<params/>", "this is no track of TORCS: it has no 'Main Track' with 'Track Segments'"),
        (b"<params>" * 100, "more than 64 within each other"),
        (xml(), "there are no segments"),
        (xml(straight()), "the road ends 100.00 m from where it begins, after 0.0 degrees of turning"),
        (xml(*OVAL[:3], curve("lft", 40, 170)), "after 350.0 degrees of turning; a circuit must come back"),
        (xml(*OVAL, main=number("width", 0)), "section 'Main Track': width is 0 m; it must be positive"),
        (xml(*OVAL, main=number("width", 10, "yd")), "the unit of width is 'yd'; it must be one of m, rad, "),
        (xml(straight(-3)), "section 'line': lg is -3; it must be at least 1e-06"),
        (xml(straight(math.nan)), "section 'line': lg is 'nan'; it must be a number of at most 100000"),
        (xml(straight().replace('"100"', '"1_0"')), "lg is '1_0'; it must be a number"),
        (xml(straight().replace('"lg"', '"length"')), "section 'line': lg is missing"),
        (xml(straight().replace('"str"', '"loop"')), "section 'line': type is 'loop'; it must be str, lft or rgt"),
        (xml(curve("lft", 0, 90)), "section 'curve': radius is 0; it must be at least 1e-06"),
        (xml(curve("lft", 9, 90, number("end radius", 5) + number("profil steps", 1e5))), "has 100000 steps"),
        (xml(*[straight(60_000)] * 2), "section 'line': the road has more than 100 km, or too many segments"),
        (xml(*OVAL, main=MAIN + side("Left Side", width=-1.0)), "width of Left Side is -1 m; it may not be negative"),
    ],
)
def test_what_is_no_track_is_refused_with_the_place_and_the_reason(read, content: bytes, says: str):
    with pytest.raises(TrackError, match=re.escape(says)) as refusal:
        read(content, walls="barriers")
    assert str(refusal.value).startswith("track 'own.xml': ")


def test_other_walls_and_options_are_refused(read, tmp_path: Path):
    with pytest.raises(TrackError, match="walls is 'grass'; it must be road or barriers"):
        read(xml(*OVAL), walls="grass")
    with pytest.raises(TrackError, match="it takes no width; its format has walls"):
        Track.load(tmp_path / "own.xml", width=5.0)
    with pytest.raises(TrackError, match="'oval': it takes no walls"):
        Track.load("oval", walls="road")


# All of TORCS


@pytest.fixture(scope="session")
def installed(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of TORCS's tracks, from Debian's package; kept in pytest's cache, without all that is no XML."""
    folder = Path(pytestconfig.cache.mkdir(PACKAGE))
    if not list(folder.rglob("*.xml")):
        place = tmp_path_factory.mktemp(PACKAGE)
        get = ["apt-get", "-o", "APT::Sandbox::User=root", "download", PACKAGE]
        try:
            subprocess.run(get, cwd=place, check=True, capture_output=True, timeout=300)
            (package,) = place.glob("*.deb")
            with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", package], stdout=subprocess.PIPE) as files:
                unpack = ["tar", "-x", "-C", folder, "--wildcards", "./usr/share/games/torcs/tracks/*.xml"]
                subprocess.run(unpack, stdin=files.stdout, check=True)
            package.unlink()
        except (OSError, subprocess.SubprocessError, ValueError) as error:
            pytest.skip(f"Debian's {PACKAGE} (333 MB) cannot be had here: {error}")
    return folder / "usr/share/games/torcs/tracks"


@pytest.mark.slow
def test_all_38_tracks_of_torcs_load_without_a_fault(installed: Path):
    files = sorted(installed.rglob("*.xml"))
    assert len(files) == 38
    for path in files:
        track = Track.load(path)
        assert inspect_track(track).faults == (), path.name
        assert len(track.bridges) == (path.name == "wheel-2.xml")
        assert widths(Track.load(path, walls="barriers")).min() > widths(track).min() - 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLISHED)
def test_lengths_are_those_that_torcs_shows(installed: Path, name: str):
    track = Track.load(installed / name / f"{Path(name).name}.xml")
    assert track.length == pytest.approx(PUBLISHED[name], abs=0.05)
