"""GeoJSON lines of longitudes and latitudes as roads."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from carrl.errors import TrackError
from carrl.tracks import geojson
from carrl.tracks.centreline import Centreline
from carrl.tracks.inspection import inspect_track
from carrl.tracks.track import Track

EAST, NORTH = 111.319491, 110.574304
"""Thousandths of a degree at longitude and latitude 0, m: pi / 180 times the equator's radius, and times that of a
meridian there, 6,335,439 m."""


def ellipse(count: int = 60, longitude: float = 0.0, latitude: float = 0.0, closed: bool = True) -> list[list[float]]:
    """Counter-clockwise, half axes of 2 and 1 thousandth of a degree, from its eastern end."""
    angle = 2 * np.pi * np.arange(count) / count
    line = np.stack([longitude + 0.002 * np.cos(angle), latitude + 0.001 * np.sin(angle)], axis=1).tolist()
    return [*line, line[0]] if closed else line


def feature(coordinates: object, kind: str = "LineString", **properties) -> dict:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def collection(*features: object) -> dict:
    return {"type": "FeatureCollection", "features": list(features)}


@pytest.fixture
def read(tmp_path: Path):
    def read(values: object, **options) -> list[Track]:
        path = tmp_path / "own.geojson"
        path.write_text(values if isinstance(values, str) else json.dumps(values))
        return Track.load_all(path, **options)

    return read


def extent(track: Track) -> list[float]:
    return (track.centreline.amax(dim=0) - track.centreline.amin(dim=0)).tolist()


def test_a_line_at_the_equator_has_the_measures_of_the_ellipsoid(read):
    (track,) = read(collection(feature(ellipse())))
    assert track.name == "own.geojson"
    assert extent(track) == pytest.approx([4 * EAST, 2 * NORTH], rel=1e-4)
    assert track.centreline[0].tolist() == pytest.approx([2 * EAST, 0], abs=0.01)
    assert inspect_track(track).least_radius_left == pytest.approx(EAST / 2 * (NORTH / EAST) ** 2, rel=0.05)
    assert inspect_track(track).faults == ()


def test_at_60_degrees_north_a_degree_of_longitude_is_half_as_long(read):
    (track,) = read(feature(ellipse(latitude=60.0)))
    along_parallel = math.radians(0.004) * 6378137 * math.cos(math.radians(60)) / math.sqrt(1 - 0.00669438 * 0.75)
    assert extent(track)[0] == pytest.approx(along_parallel, rel=1e-4)


def test_the_180th_meridian_parts_nothing(read):
    wrapped = [[(x + 180) % 360 - 180, y] for x, y in ellipse(longitude=180.0)]
    (track,) = read({"type": "LineString", "coordinates": wrapped})
    assert extent(track) == pytest.approx([4 * EAST, 2 * NORTH], rel=1e-4)


def test_a_road_is_12_m_wide_unless_told_otherwise(read):
    (track,), (narrow,) = read(feature(ellipse())), read(feature(ellipse()), width=7.5)
    assert inspect_track(track).width_min == pytest.approx(12, abs=0.01)
    assert inspect_track(narrow).width_max == pytest.approx(7.5, abs=0.01)


def test_the_direction_is_that_of_the_line_or_the_other_one(read):
    (track,), (back,) = read(feature(ellipse())), read(feature(ellipse()), direction="clockwise")
    assert inspect_track(track).least_radius_right is None
    assert inspect_track(back).least_radius_left is None
    assert back.centreline[0].tolist() == track.centreline[0].tolist()


def test_a_doubled_point_and_an_open_end_of_a_step_do_no_harm(read):
    line = ellipse(closed=False)
    (track,) = read(feature([*line[:20], line[19], *line[20:]]))
    (plain,) = read(feature(ellipse()))
    assert track.length == pytest.approx(plain.length, abs=0.01)
    assert track.repeats == 1


def test_a_straight_between_points_far_apart_stays_straight(read):
    """Two half circles of 60 m radius, 10 m between points, at the ends of straights of a kilometre without any."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20)
    bend = 60 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [500, 0]
    metres = np.vstack([bend, -bend])
    line = (metres / [EAST, NORTH] / 1000).tolist()
    (track,) = read(feature([*line, line[0]]))
    on_straight = track.centreline[track.centreline[:, 0].abs() < 450]
    np.testing.assert_allclose(on_straight[:, 1].abs(), 60, atol=0.05)


def test_one_circuit_of_many_is_chosen_by_its_id_or_else_its_name(read, tmp_path: Path):
    many = collection(
        feature([0, 0], "Point"),
        feature(ellipse(), Name="First Ring"),
        feature(ellipse(latitude=50), id="two"),
        feature(ellipse(latitude=10), id="two"),
    )
    assert [track.name for track in read(many)] == [f"own.geojson/{name}" for name in ("First Ring", "two", "two-4")]
    path = tmp_path / "own.geojson"
    assert Track.load(path, circuit="First Ring").name == "own.geojson/First Ring"
    with pytest.raises(TrackError, match="it has 3 circuits, First Ring, two, two-4; name one as track"):
        Track.load(path)
    with pytest.raises(TrackError, match="there is no circuit 'three' in it; it has First Ring, two, two-4"):
        Track.load(path, circuit="three")


def test_what_was_written_is_read_with_its_widths_at_the_same_place(tmp_path: Path):
    angle = 2 * np.pi * np.arange(90) / 90
    points = np.stack([900 + 300 * np.cos(angle), -400 + 150 * np.sin(angle)], axis=1)
    centreline = Centreline(points, width_right=4 + np.cos(angle), width_left=5 + np.sin(angle))
    path = tmp_path / "ring.geojson"
    geojson.write(path, centreline)
    track, written = Track.load(path), Track.from_centreline("ring", centreline)
    for part in ("centreline", "left_wall", "right_wall"):
        np.testing.assert_allclose(getattr(track, part), getattr(written, part), atol=1e-3)
    with pytest.raises(TrackError, match=r"width is 6\.0, but this line has widths of its own"):
        Track.load(path, width=6.0)


def test_what_was_written_has_its_points_to_ten_micrometres(tmp_path: Path):
    """A tenth of a millimetre is enough to cut the inner wall of a hairpin elsewhere."""
    points = np.array([[100.123456, 7.7], [80.654321, 90.5], [-95.2, 60.1], [-60.7, -80.3]])
    geojson.write(tmp_path / "ring.geojson", Centreline(points, np.full(4, 4.0), np.full(4, 4.0)))
    np.testing.assert_allclose(geojson.read(tmp_path / "ring.geojson")[0].centre, points, rtol=0, atol=1e-5)


def test_a_multi_line_string_of_one_line_is_that_line_and_what_has_no_geometry_is_left_out(read):
    (usual,) = read(feature(ellipse()))
    (one,) = read(collection(feature([ellipse()], "MultiLineString"), {"type": "Feature", "geometry": None}))
    np.testing.assert_array_equal(one.centreline, usual.centreline)


def test_a_circuit_goes_by_a_number_or_by_the_id_beside_its_properties_too(read):
    many = collection(feature(ellipse(), id=2), feature(ellipse(), id=1), {**feature(ellipse()), "id": "way/7"})
    assert [track.name for track in read(many)] == [f"own.geojson/{name}" for name in ("2", "1", "way/7")]


@pytest.mark.parametrize("origin", ["a survey", [0, 40], 3])
def test_an_origin_that_another_tool_wrote_moves_nothing(read, origin: object):
    (usual,), (other,) = read(feature(ellipse())), read(feature(ellipse(), origin=origin))
    np.testing.assert_array_equal(other.centreline, usual.centreline)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ("{", "this is not a JSON text file"),
        ("[" * 100_000, "this is not a JSON text file"),
        ({}, "this JSON is no GeoJSON: it must be a FeatureCollection, a Feature or a LineString"),
        ([1], "this JSON is no GeoJSON"),
        (collection(3), "this JSON is no GeoJSON"),
        (collection(), "there is no LineString in it, so no road"),
        (collection(feature([0, 0], "Point")), "there is no LineString in it, so no road; points are only places"),
        (feature([ellipse()], "Polygon", name="lake"), "circuit 'lake': its geometry is 'Polygon'; it must be a Line"),
        (feature(ellipse()[:2]), "circuit '1': it must have a list of 3 to 20000 coordinates"),
        (feature([*ellipse()[:5], ["7", 50]]), "position 6 is ['7', 50]; it must be [longitude, latitude] in degrees"),
        (feature([*ellipse()[:5], [690_000, 5_300_000]]), "it must be [longitude, latitude] in degrees"),
        (feature([*ellipse()[:5], [math.nan, 0]]), "position 6 is [nan, 0]"),
        (feature([[0, 0], [0, 0], [0, 0], [1e-9, 0]]), "1 points; a closed road needs at least 3"),
        (feature([[0, 0], [10, 0], [0, 10], [0, 0]]), "its points are more than 100 km from their middle"),
        (feature(ellipse()[:40]), "the line ends 365 m from where it begins; draw it all the way round"),
        (feature(ellipse(), width_left=[1], width_right=[1]), "width_left must be a list of a positive number"),
        (feature(ellipse(), width_left=[3.0] * 61), "it has one of width_left and width_right; give both, or none"),
        (
            feature(ellipse(), origin=3, width_left=[3.0] * 61, width_right=[3.0] * 61),
            "origin is 3; it must be [longitude, latitude]",
        ),
    ],
)
def test_what_is_no_road_is_refused_with_the_reason(read, values: object, says: str):
    with pytest.raises(TrackError, match=re.escape(says)) as refusal:
        read(values)
    assert str(refusal.value).startswith("track 'own.geojson': ")


@pytest.mark.parametrize("width", [0, -1, math.inf, math.nan, "wide", True])
def test_a_width_is_a_positive_number(read, width: object):
    with pytest.raises(TrackError, match="it must be a positive number of metres"):
        read(feature(ellipse()), width=width)
