"""Laps in a picture and in a video."""

import numpy as np
import pytest
from PIL import Image

from carrl.errors import CarrlError
from carrl.render.colours import LAPS, rgb
from carrl.render.laps_figure import _costliest, draw_laps
from carrl.render.laps_video import GAP, HOLD, SPEED, write_laps_video
from tests.driven_laps import steady_lap
from tests.racing.laps import ring


@pytest.fixture(scope="module")
def laps():
    road = ring()
    return [steady_lap(road, 200.0, "fast", step=0.02), steady_lap(road, 160.0, "slow", step=0.02)]


def like(picture, colour, tolerance=40):
    return np.abs(picture.astype(int) - np.array(rgb(colour))).max(axis=-1) <= tolerance


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_picture_has_every_lap_in_its_colour(tmp_path, laps, count):
    part = steady_lap(ring(), 100.0, "part", end=100.0)
    draw_laps(tmp_path / "laps.png", ring(), [*laps, part][:count])
    with Image.open(tmp_path / "laps.png") as image:
        picture = np.asarray(image.convert("RGB"))
    for index, colour in enumerate(LAPS[:3]):
        assert (like(picture, colour).sum() > 100) == (index < count)


def test_the_close_up_is_where_most_is_lost():
    stations = np.linspace(0, 1000, 1000)
    gaps = np.interp(stations, [0, 400, 460, 1000], [0, 1, 4, 4.5])
    begin, end = _costliest(stations, gaps)
    assert (begin, end) == pytest.approx((400, 460), abs=3)
    assert _costliest(stations, np.where(stations > 600, np.nan, gaps)) == (begin, end)


def test_a_video_lasts_as_long_as_the_slowest_lap(tmp_path, laps):
    av = pytest.importorskip("av", reason="videos need PyAV, which is not installed")
    drawn = []
    write_laps_video(tmp_path / "laps.mp4", ring(), laps, lambda done, of: drawn.append((done, of)))
    with av.open(tmp_path / "laps.mp4") as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    count = int(np.ceil(laps[1].lap_time * 30)) + 1
    assert len(pictures) == count + 30 * HOLD
    assert drawn[-1] == (count, count)
    for area in (SPEED, GAP):
        left, right, top, bottom = map(int, (area.left, area.right, area.top, area.bottom))
        fast, slow = (like(pictures[count // 2][top - 4 : bottom + 4, left : right + 4], each) for each in LAPS[:2])
        ends = fast.any(axis=0).nonzero()[0].max(), slow.any(axis=0).nonzero()[0].max()
        assert ends[0] > 1.15 * ends[1]  # as far as each has come


def test_a_video_of_another_ending_is_refused(tmp_path, laps):
    with pytest.raises(CarrlError, match=r"it must end in \.mp4 or \.gif"):
        write_laps_video(tmp_path / "laps.avi", ring(), laps)
