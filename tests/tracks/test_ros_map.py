"""Maps of ROS as roads: synthetic ones, of which the truth is known, and those of F1TENTH where they are at hand."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import shapely
from PIL import Image
from scipy.spatial import KDTree
from shapely import LinearRing

from carrl.errors import TrackError
from carrl.tracks import ros_map
from carrl.tracks.inspection import inspect_track
from carrl.tracks.rings import CorridorError, resampled
from carrl.tracks.track import Track

F1TENTH = Path(__file__).parents[3] / "shared" / "tracks" / "f1tenth"
KEYS = {"resolution": 0.05, "origin": "[0, 0, 0]", "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25}


def write_map(folder: Path, picture: np.ndarray, **keys) -> Path:
    """A map whose picture has row 0 at the bottom."""
    Image.fromarray(np.ascontiguousarray(picture[::-1])).save(folder / "map.png")
    values = {"image": "map.png", **KEYS, **keys}
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in values.items() if value is not None))
    return path


def distances(rows: int, columns: int, centre: tuple[float, float]) -> np.ndarray:
    """Of each pixel's middle from a point, pixels."""
    y, x = np.mgrid[:rows, :columns] + 0.5
    return np.hypot(x - centre[0], y - centre[1])


def ring(inner: float = 40, outer: float = 70, size: int = 160) -> np.ndarray:
    away = distances(size, size, (size / 2, size / 2))
    return np.where((away > inner) & (away < outer), 254, 0).astype(np.uint8)


def radii(points, centre: float) -> np.ndarray:
    return np.linalg.norm(np.asarray(points, dtype=np.float64) - centre, axis=1)


def test_a_round_corridor_has_its_walls_and_its_middle_where_they_were_drawn(tmp_path):
    track = Track.load(write_map(tmp_path, ring()))
    assert radii(track.left_wall, 4.0) == pytest.approx(2.0, abs=0.04)  # 40 pixels of 5 cm
    assert radii(track.right_wall, 4.0) == pytest.approx(3.5, abs=0.04)
    assert radii(track.centreline, 4.0) == pytest.approx(2.75, abs=0.04)
    assert inspect_track(track, body_radius=0.1).faults == ()
    assert track.notes == ("the middle of the free space",)


def test_edges_that_are_drawn_softly_are_found_to_a_fifth_of_a_pixel(tmp_path):
    away = distances(160, 160, (80, 80))
    cover = np.clip(away - 40 + 0.5, 0, 1) * np.clip(70 - away + 0.5, 0, 1)
    track = Track.load(write_map(tmp_path, (255 * cover).astype(np.uint8)))
    walls = [resampled(wall.double().numpy(), 0.02) for wall in (track.left_wall, track.right_wall)]
    assert np.median(radii(walls[0], 4.0)) == pytest.approx(2.0, abs=0.01)
    assert np.median(radii(walls[1], 4.0)) == pytest.approx(3.5, abs=0.01)


def test_the_road_between_two_thin_lines_in_white_is_neither_the_infield_nor_the_outside(tmp_path):
    away = distances(160, 160, (80, 80))
    lines = (np.abs(away - 40) < 1.5) | (np.abs(away - 70) < 1.5)
    track = Track.load(write_map(tmp_path, np.where(lines, 0, 254).astype(np.uint8)))
    assert radii(track.centreline, 4.0) == pytest.approx(2.75, abs=0.05)


def test_a_map_is_moved_and_turned_by_its_origin(tmp_path):
    plain = Track.load(write_map(tmp_path, ring(), origin="[0, 0, 0]"), start_at=(8.0, 4.0))
    turned = Track.load(write_map(tmp_path, ring(), origin=f"[10, -2, {math.pi / 2}]"), start_at=(6.0, 6.0))
    x, y = plain.centreline[0].tolist()
    assert turned.centreline[0].tolist() == pytest.approx([10 - y, -2 + x], abs=0.06)
    assert turned.length == pytest.approx(plain.length, rel=1e-3)


def test_negate_and_thresholds_tell_what_is_free(tmp_path):
    usual = Track.load(write_map(tmp_path, ring()))
    negated = Track.load(write_map(tmp_path, 255 - ring(), negate=1))
    assert negated.length == pytest.approx(usual.length, rel=1e-6)
    grey = np.where(ring() > 0, 150, 0).astype(np.uint8)  # occupied by 41 %
    assert Track.load(write_map(tmp_path, grey, free_thresh=0.5)).length == pytest.approx(usual.length, rel=1e-6)
    with pytest.raises(TrackError, match="no closed corridor"):
        Track.load(write_map(tmp_path, grey, free_thresh=0.3))


@pytest.mark.parametrize("kind", ["L", "RGB", "RGBA", "P", "I;16", "1"])
def test_pictures_of_all_kinds_are_read_alike(tmp_path, kind):
    usual = Track.load(write_map(tmp_path, ring()))
    image = Image.fromarray(ring()[::-1])
    deep = Image.fromarray(ring()[::-1].astype(np.uint16) * 257)
    (deep if kind == "I;16" else image.convert(kind)).save(tmp_path / "map.png")
    assert Track.load(tmp_path / "map.yaml").length == pytest.approx(usual.length, rel=1e-6)
    image.save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text((tmp_path / "map.yaml").read_text().replace("map.png", "map.pgm"))
    assert Track.load(tmp_path / "map.yaml").length == pytest.approx(usual.length, rel=1e-6)


@pytest.mark.parametrize("transparent", ["L", "P"])
def test_a_colour_that_means_transparent_is_not_free(tmp_path, transparent):
    usual = Track.load(write_map(tmp_path, ring()))
    shades = np.where(ring() > 0, 250, 251).astype(np.uint8)
    image = Image.fromarray(shades[::-1])
    if transparent == "P":
        image.putpalette([255] * 768)
    image.save(tmp_path / "map.png", transparency=251)
    assert Track.load(tmp_path / "map.yaml").length == pytest.approx(usual.length, rel=1e-6)


def test_yellow_lines_on_white_are_walls_as_they_are_to_a_map_server(tmp_path):
    away = distances(160, 160, (80, 80))
    lines = ((away > 36) & (away < 40)) | ((away > 70) & (away < 74))
    picture = np.where(lines[:, :, None], (255, 255, 0), (255, 255, 255)).astype(np.uint8)
    assert radii(Track.load(write_map(tmp_path, picture)).left_wall, 4.0) == pytest.approx(2.0, abs=0.04)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("image:", "\ufeffimage:"),
        ("image", '"image"'),
        ("resolution:", "resolution :"),
        ("0.05", "5e-2"),
        ("[0, 0, 0]", "[0.0e0, 0, -5e-17]"),
        ("negate: 0", "negate: 0\nmode: Trinary"),
    ],
)
def test_a_map_may_be_written_in_other_ways_of_yaml(tmp_path, old, new):
    path = write_map(tmp_path, ring())
    usual, text = Track.load(path), path.read_text()
    path.write_text(text.replace(old, new), encoding="utf-8")
    assert Track.load(path).length == pytest.approx(usual.length, rel=1e-6)
    path.write_text("{" + text.strip().replace("\n", ", ") + "}")
    assert Track.load(path).length == usual.length


# Start and direction


def test_a_road_starts_at_the_origin_along_its_x_axis_where_a_robot_began_to_map(tmp_path):
    """At the bottom of the ring +x is counter-clockwise, and at its top clockwise."""
    for row, clockwise in ((25, False), (135, True)):
        track = Track.load(write_map(tmp_path, ring(), origin=f"[-4, {-row * 0.05}, 0]"))
        assert track.centreline[0].norm() < 0.1
        assert track.centreline[1, 0] > 0
        assert (LinearRing(track.centreline.numpy()).is_ccw) != clockwise


def test_a_centreline_beside_the_map_gives_middle_start_and_direction(tmp_path):
    path = write_map(tmp_path, ring())
    angle = -np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = 4 + 2.6 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = [f"{x},{y},0.5,0.5" for x, y in circle.tolist()]
    (tmp_path / "map_centerline.csv").write_text("\n".join(rows))
    track = Track.load(path)
    assert track.notes == ("centreline, start and direction from map_centerline.csv",)
    assert track.centreline[0].tolist() == pytest.approx([6.6, 4.0], abs=0.05)
    assert not LinearRing(track.centreline.numpy()).is_ccw
    assert radii(track.centreline, 4.0) == pytest.approx(2.6, abs=0.03)
    assert radii(track.left_wall, 4.0) == pytest.approx(3.5, abs=0.04)  # clockwise, the outer wall is on the left
    (tmp_path / "map_centerline.csv").write_text("\n".join(row.replace("6.6", "9.9") for row in rows))
    with pytest.raises(TrackError, match=r"^track 'map\.yaml': the given centreline leaves the road at column"):
        Track.load(path)


def test_direction_and_start_by_option(tmp_path):
    path = write_map(tmp_path, ring())
    track = Track.load(path, direction="clockwise", start_at=(4.0, 9.0), scale=2.0)
    assert not LinearRing(track.centreline.numpy()).is_ccw
    assert KDTree(track.centreline.numpy()).query([4.0, 9.0])[1] == 0
    assert radii(track.centreline, 8.0) == pytest.approx(5.5, abs=0.08)
    with pytest.raises(TrackError, match="direction is 'left'; it must be clockwise or counterclockwise"):
        Track.load(path, direction="left")
    with pytest.raises(TrackError, match=r"start_at is \[1\]; it must be \[x, y\]"):
        Track.load(path, start_at=[1])


# What is no circuit, by name


def road(*rectangles: tuple[int, int, int, int], size: int = 200) -> np.ndarray:
    """Free rectangles (left, bottom, right, top), pixels."""
    picture = np.zeros((size, size), dtype=np.uint8)
    for left, bottom, right, top in rectangles:
        picture[bottom:top, left:right] = 254
    return picture


LOOP = ((20, 20, 180, 40), (20, 160, 180, 180), (20, 20, 40, 180), (160, 20, 180, 180))


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (road(), "no closed corridor"),
        (road((20, 20, 180, 180)), "no closed corridor"),
        (road(*LOOP[:3]), "no closed corridor"),
        (road(*LOOP, (20, 90, 180, 110)), r"forks and has 2 loops, one of them around column 100, row \d+"),
        (road(*LOOP, (40, 90, 110, 110)), r"the corridor branches: a side arm ends at column 1[01][09], row \d+"),
        (road((10, 10, 90, 30), (10, 70, 90, 90), (10, 10, 30, 90), (70, 10, 90, 90),
              (110, 10, 190, 30), (110, 70, 190, 90), (110, 10, 130, 90), (170, 10, 190, 90)), "2 closed corridors"),
        (road((0, 0, 200, 20), (0, 180, 200, 200), (0, 0, 20, 200), (180, 0, 200, 200)), "keep the road off the pict"),
    ],
)  # fmt: skip
def test_what_is_no_one_closed_corridor_is_refused_by_name(tmp_path, picture, says):
    with pytest.raises(CorridorError, match=rf"^track 'map\.yaml': .*{says}") as error:
        Track.load(write_map(tmp_path, picture))
    assert "\n" not in str(error.value)
    assert error.value.free is not None


def test_a_road_may_touch_the_edge_of_the_picture_here_and_there(tmp_path):
    track = Track.load(write_map(tmp_path, ring(inner=50, outer=79.7)))
    assert radii(track.centreline, 4.0) == pytest.approx(3.25, abs=0.04)


def test_an_island_in_the_road_joins_the_nearer_wall_and_the_road_goes_by_on_the_wider_side(tmp_path):
    picture = road(*LOOP)
    picture[22:27, 100:106] = 0  # near the outer wall
    track = Track.load(write_map(tmp_path, picture))
    assert "1 islands in the road, each joined to the wall nearer to it" in track.notes
    walls = shapely.multilinestrings(list(track.walls.numpy()))
    assert walls.distance(shapely.Point(5.15, 1.35)) < 0.05  # its inner side is a wall
    assert shapely.LineString(track.centreline[:, :].tolist()).distance(shapely.Point(5.15, 1.25)) > 0.3
    assert inspect_track(track, body_radius=0.1).faults == ()


def test_a_bay_beside_the_road_keeps_its_walls(tmp_path):
    picture = road(*LOOP, (90, 40, 120, 50))
    track = Track.load(write_map(tmp_path, picture))
    walls = shapely.multilinestrings(list(track.walls.numpy()))
    assert walls.distance(shapely.Point(105 * 0.05, 50 * 0.05)) < 0.05


# Bad files


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"free_thresh": None}, "this map lacks free_thresh; nav2's map saver writes negate: 0, occupied_thresh: 0.65"),
        ({"negate": None, "origin": None}, "this map lacks origin, negate; "),
        ({"resolution": 0}, "resolution is 0; it must be a number from 0.001 to 100"),
        ({"resolution": ".nan"}, "resolution is nan; it must be a number"),
        ({"origin": "[0]"}, r"origin is \[0\]; it must be \[x, y, yaw\]"),
        ({"origin": "[0, east, 0]"}, "origin's y is 'east'; it must be a number"),
        ({"negate": 2}, "negate is 2; it must be a number from 0 to 1"),
        ({"free_thresh": 0.9}, "free_thresh is 0.9, above occupied_thresh, which is 0.65"),
        ({"mode": "raw"}, "mode is 'raw'; CarRL reads trinary and scale"),
        ({"image": "7"}, "image is 7; it must be the name"),
        ({"image": "other.png"}, "the picture 'other.png' is not there; put it beside the YAML file"),
        ({"image": "a" * 5000}, r"the picture 'a{5,30}\.\.\.a*'? ?.*is not there; put it beside"),
        ({"image": "map.yaml"}, "the picture 'map.yaml' is damaged, or neither PNG nor PGM nor BMP"),
    ],
)
def test_a_bad_map_is_refused_with_one_sentence(tmp_path, keys, says):
    with pytest.raises(TrackError, match=rf"^track 'map\.yaml': {says}") as error:
        Track.load(write_map(tmp_path, ring(), **keys))
    assert "\n" not in str(error.value)


def test_a_picture_of_too_many_pixels_is_refused_before_it_is_unpacked(tmp_path):
    path = write_map(tmp_path, ring())
    Image.new("1", (20_000, 20_000)).save(tmp_path / "map.png")
    with pytest.raises(TrackError, match="has a huge number of pixels; it must have from 9 to 16,777,216"):
        Track.load(path)


# Writing


@pytest.mark.parametrize("name", ["oval", "paper", "serpentine"])
def test_a_map_that_was_written_reads_back_to_a_pixel(tmp_path, name):
    track = Track.load(name)
    files = ros_map.write(tmp_path / "road.png", track, 0.1)
    assert [file.name for file in files] == ["road.png", "road.yaml", "road_centerline.csv"]
    back = Track.load(tmp_path / "road.yaml")
    for wall, other in ((track.left_wall, back.left_wall), (track.right_wall, back.right_wall)):
        tree = KDTree(resampled(other.double().numpy(), 0.02))
        assert tree.query(resampled(wall.double().numpy(), 0.02))[0].max() < 0.1
    assert back.centreline[0].tolist() == pytest.approx(track.centreline[0].tolist(), abs=0.1)
    assert back.length == pytest.approx(track.length, rel=1e-3)


# The maps of F1TENTH


@pytest.mark.skipif(not F1TENTH.is_dir(), reason="the maps of F1TENTH are not beside this checkout")
@pytest.mark.parametrize("name", ["aut", "esp", "gbr", "mco"])
@pytest.mark.parametrize("alone", [False, True])
def test_f1tenth_maps_have_walls_within_5_cm_of_the_edge_and_the_centreline_of_the_file(tmp_path, name, alone):
    for file in F1TENTH.glob(f"{name}*"):
        if not (alone and "centerline" in file.name):
            (tmp_path / file.name).write_bytes(file.read_bytes())
    track = Track.load(tmp_path / f"{name}.yaml")
    x, y = map(float, re.search(r"origin: *\[([-\d.]+), *([-\d.]+)", (tmp_path / f"{name}.yaml").read_text()).groups())
    free = np.asarray(Image.open(tmp_path / f"{name}.png"))[::-1] > 128
    across, along = np.nonzero(free[:, 1:] != free[:, :-1]), np.nonzero(free[1:] != free[:-1])
    edges = np.concatenate([np.stack([across[1] + 1, across[0] + 0.5], 1), np.stack([along[1] + 0.5, along[0] + 1], 1)])
    edges = edges * 0.05 + (x, y)
    walls = np.concatenate([resampled(w.double().numpy(), 0.01) for w in (track.left_wall, track.right_wall)])
    assert KDTree(edges).query(walls)[0].max() < 0.05
    assert KDTree(walls).query(edges)[0].max() < 0.05
    given = np.loadtxt(F1TENTH / f"{name}_centerline.csv", delimiter=",")[:, :2]
    off = KDTree(resampled(track.centreline.double().numpy(), 0.01)).query(given)[0]
    # Without the file, its own line stands up to 0.3 m off the middle of the free space in a few corners.
    assert (np.quantile(off, 0.99) if alone else off.max()) < 0.1
    assert inspect_track(track, body_radius=0.15).faults == ()
