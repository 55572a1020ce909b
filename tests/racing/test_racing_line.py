"""A lap as a table, and as a CSV file."""

import numpy as np
import pytest

from carrl.errors import TrackError
from carrl.racing.reference_line import COLUMNS, ReferenceLine
from carrl.tracks.track import Track
from tests.racing.laps import oval_lap


def test_a_written_line_is_read_back(tmp_path):
    line = oval_lap().line
    line.write(tmp_path / "line.csv")
    back = ReferenceLine.read(tmp_path / "line.csv")
    for name in COLUMNS.values():
        np.testing.assert_allclose(getattr(back, name), getattr(line, name), rtol=1e-8, atol=1e-8)
    for name in ("lap_time", "length", "track_length", "turn"):
        assert getattr(back, name) == pytest.approx(getattr(line, name), rel=1e-8)


def test_the_last_row_is_the_first_a_lap_later(tmp_path):
    line = oval_lap().line
    line.write(tmp_path / "line.csv")
    table = np.loadtxt(tmp_path / "line.csv", delimiter=",")
    columns = dict(zip(COLUMNS, table.T, strict=True))
    assert columns["time_s"][[0, -1]] == pytest.approx([0, line.lap_time])
    assert columns["heading_rad"][-1] - columns["heading_rad"][0] == pytest.approx(2 * np.pi)
    assert columns["x_m"][0] == columns["x_m"][-1]


def test_the_file_is_a_raceline_to_the_track_reader(tmp_path):
    line = oval_lap().line
    line.write(tmp_path / "line.csv")
    reference = Track.load(tmp_path / "line.csv", width=10.0).reference_line
    np.testing.assert_allclose(reference.numpy(), line.places, atol=1e-4)


def test_curvature_and_distance_are_those_of_the_way():
    line = oval_lap().line
    turned = (line.curvature * np.gradient(line.closed().distance)[:-1]).sum()
    assert turned == pytest.approx(2 * np.pi, rel=0.02)
    assert line.length == pytest.approx(197.0, abs=1.5)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("# station_m", "# where"), "its first line must be"),
        (lambda text: text.replace("\n0,", "\nx,"), "every row must have 14 numbers"),
        (lambda text: "\n".join(text.splitlines()[:3]), "more than 3 rows"),
        (lambda text: "\n".join([*text.splitlines()[:3], *text.splitlines()[2:]]), "station must grow"),
        (lambda text: text.replace("\n0,", "\nnan,"), "values that are no numbers"),
    ],
)
def test_another_file_is_refused_in_a_sentence(tmp_path, change, says):
    path = tmp_path / "line.csv"
    oval_lap().line.write(path)
    path.write_text(change(path.read_text()))
    with pytest.raises(TrackError, match=f"^line 'line.csv': .*{says}"):
        ReferenceLine.read(path)
