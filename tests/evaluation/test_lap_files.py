"""Laps to be compared, from the files that other commands write."""

import re

import numpy as np
import pytest

from carrl.errors import CarrlError
from carrl.evaluation.lap_files import MOST_LAPS, read_laps
from carrl.evaluation.speed_trace import HEADER
from carrl.racing.reference_line import COLUMNS, from_table
from carrl.tracks.track import Track
from tests.driven_laps import moments, steady, write_trace
from tests.racing.laps import ring

SPEED = 20.0


@pytest.fixture(scope="module")
def road():
    return ring()


def write_line(path, road, speed=SPEED):
    """A reference line along the middle of the road."""
    stations = np.linspace(0, road.length, 101)
    _, poses, _ = moments(road, stations, speed)
    columns = {name: np.zeros(101) for name in COLUMNS}
    columns |= {"station_m": stations, "distance_m": stations, "time_s": stations / speed}
    columns |= {"x_m": poses[:, 0], "y_m": poses[:, 1], "heading_rad": np.unwrap(poses[:, 2])}
    columns["speed_mps"] = np.full(101, speed)
    from_table(np.column_stack(list(columns.values())), "line").write(path)
    return path


def test_both_kinds_of_files_are_told_by_their_headers(tmp_path, road):
    limit, policy = write_line(tmp_path / "limit.csv", road), write_trace(tmp_path / "p.csv", road, steady(road, 16.0))
    laps = read_laps([limit, policy], road)
    assert [lap.name for lap in laps] == ["limit", "p"]
    assert [lap.lap_time for lap in laps] == pytest.approx([road.length / 20, road.length / 16], abs=2e-3)


def test_several_drivers_of_a_file_are_told_apart_and_only_the_start_line_counts(tmp_path, road):
    path = write_trace(tmp_path / "ten.csv", road, {"seed 0": steady(road, 16.0), "seed 1": steady(road, 18.0)})
    elsewhere = steady(road, 17.0, begin=60.0)
    other = write_trace(tmp_path / "other.csv", road, elsewhere, start=60.0)
    path.write_text(path.read_text() + other.read_text().partition("\n")[2])
    laps = read_laps([path], road)
    assert [lap.name for lap in laps] == ["ten: seed 0", "ten: seed 1"]
    with pytest.raises(CarrlError, match=r"it has no lap of track 'ring' from its start line on$"):
        read_laps([other], road)


def test_files_of_one_name_are_called_by_their_paths(tmp_path, road):
    paths = []
    for day in ("today", "yesterday"):
        (tmp_path / day).mkdir()
        paths.append(write_trace(tmp_path / day / "lap.csv", road, steady(road, 16.0)))
    assert [lap.name for lap in read_laps(paths, road)] == list(map(str, paths))
    with pytest.raises(CarrlError, match="is named twice"):
        read_laps([paths[0], paths[0]], road)


def test_laps_of_another_track_are_named(tmp_path, road):
    path = write_trace(tmp_path / "lap.csv", road, steady(road, 16.0))
    with pytest.raises(CarrlError, match="no lap of track 'oval' from its start line on; its laps are of ring"):
        read_laps([path], Track.load("oval"))


def test_more_laps_than_colours_are_refused(tmp_path, road):
    path = write_trace(tmp_path / "ten.csv", road, {f"seed {n}": steady(road, 20.0) for n in range(MOST_LAPS + 1)})
    with pytest.raises(CarrlError, match=f"there are {MOST_LAPS + 1} laps, .* at most {MOST_LAPS} can be told apart"):
        read_laps([path], road)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "its first line is none that is known"),
        ("a,b\n1,2\n", "its first line is none that is known"),
        (",".join(HEADER) + "\nx,ring,0,0,0,1\n", "row 2 is 'x,ring,0,0,0,1'; it must be driver,track"),
        (",".join(HEADER) + "\nx,ring,0,0,0,1,1,nan,1\n", "row 2 is"),
        (",".join(HEADER) + "\nx,ring,0,0,0,40,0,1,1\nx,ring,0,0,0,40,0,1,1\n", "row 3 is at 0 s; time must grow"),
        (",".join(HEADER) + "\nx,ring,0,0,0,40,0,1,1\n", "the lap of x has 1 moments; it must have at least 3"),
        (",".join(HEADER) + "\n", "it has no lap of track 'ring'"),
        ("# " + ",".join(COLUMNS) + "\n1,2\n", "it must have 14 columns"),
    ],
)
def test_what_is_no_lap_is_refused_in_a_sentence(tmp_path, road, text, says):
    path = tmp_path / "lap.csv"
    path.write_text(text)
    with pytest.raises(CarrlError, match=re.escape(says)) as refused:
        read_laps([path], road)
    assert "\n" not in str(refused.value)
