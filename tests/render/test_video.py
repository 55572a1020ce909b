"""Videos are decoded again: their length, their size, and the car where it should be."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from carrl.errors import CarrlError
from carrl.log.trace import EpisodeTrace
from carrl.render.colours import BLUE, GREEN, LIGHT, VERMILLION, YELLOW, rgb
from carrl.render.encoding import gif_palette
from carrl.render.video import motion_of, write_video

av = pytest.importorskip("av", reason="videos need PyAV, which is not installed")

STEPS = 14
SCALE = (664 - 2 * 34) / 20
"""Pixels per metre of the track of the fixture, which is 20 m high, in the picture's area of 664 pixels."""
MIDDLE = np.array([450, 388])
"""The picture's place of the track's middle, (10 m, 10 m)."""
PEDALLED = ((1, GREEN), (6, VERMILLION))
"""Steps in which a pedal is fully down, and the colour of its bar."""


@pytest.fixture(scope="module")
def mp4(trace, tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "episode.mp4"
    write_video(path, trace, "a small drive")
    return path


@pytest.fixture(scope="module")
def pictures(mp4):
    """All pictures of the mp4, [F, H, W, 3]."""
    with av.open(mp4) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def like(picture, colour, tolerance=40):
    """Which pixels have about this colour, [H, W]."""
    difference = picture.astype(int) - np.round(255 * np.array(to_rgb(colour))).astype(int)
    return np.abs(difference).max(axis=-1) <= tolerance


def car_in(picture):
    """Middle of the car's disc, x and y in pixels; nothing else is yellow."""
    rows, columns = np.nonzero(like(picture, YELLOW))
    assert len(rows) > 20
    return np.array([(columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2])


def changed(trace, **columns):
    return EpisodeTrace(trace.scene, {**trace.columns, **columns})


def enlarged(trace, factor):
    """The same drive on a track so many times as large, whose start is the same place."""
    track, start = trace.track, np.array([10.0, 3.0])
    shapes = {name: (getattr(track, name) - start) * factor + start for name in ("centreline", "walls", "gates")}
    large = replace(track, length=track.length * factor, **shapes)
    return EpisodeTrace(replace(trace.scene, tracks=(large,)), trace.columns)


def test_an_mp4_takes_as_long_as_the_episode_and_holds_its_end_for_a_second(mp4):
    with av.open(mp4) as container:
        video = container.streams.video[0]
        assert (video.codec_context.name, video.pix_fmt) == ("h264", "yuv420p")
        assert (video.width, video.height, video.average_rate) == (1280, 720, 20)
        assert sum(1 for _ in container.decode(video)) == 2 * STEPS + 1 + 20
        assert float(video.duration * video.time_base) == pytest.approx(STEPS * 0.1 + 1, abs=0.05)


def test_an_mp4_says_that_its_colours_are_those_of_high_definition(mp4):
    with av.open(mp4) as container:
        assert container.streams.video[0].codec_context.colorspace == 1


def test_a_gif_shows_two_pictures_a_step_at_real_time(trace, tmp_path):
    path = tmp_path / "episode.GIF"
    write_video(path, trace, "a small drive")
    with Image.open(path) as image:
        assert (image.format, image.size, image.n_frames) == ("GIF", (640, 360), 2 * STEPS + 1 + 20)
        assert image.info["duration"] == 50
        assert image.info["loop"] == 0
        picture = np.asarray(image.convert("RGB"))
        assert (picture[5, 5] == 255).all()
        assert car_in(picture) * 2 == pytest.approx(MIDDLE + np.array([0, 7 * SCALE]), abs=2)


@pytest.mark.parametrize("step", [0, 4, 10])
def test_the_car_is_where_the_log_has_it(trace, pictures, step):
    position = trace.poses[step, :2] - 10
    assert car_in(pictures[2 * step]) == pytest.approx(MIDDLE + position * (SCALE, -SCALE), abs=2)


def test_the_line_driven_grows_in_the_colour_of_the_actions(trace, pictures):
    x, y = np.round(MIDDLE + (trace.poses[2:6, :2].mean(axis=0) - 10) * (SCALE, -SCALE)).astype(int)
    before, after = (like(picture[y - 40 : y + 40, x - 40 : x + 40], VERMILLION).sum() for picture in pictures[[2, 27]])
    assert before == 0
    assert after > 50


def test_a_gate_lights_up_for_half_a_second_after_it_was_passed(trace, pictures):
    passed = int(np.flatnonzero(np.diff(trace.gates_passed))[0])
    x, y = np.round(MIDDLE + (np.array([19.0, 10.0]) - 10) * (SCALE, -SCALE)).astype(int)  # on the gate, beside the car
    lit = [like(pictures[2 * step][y - 3 : y + 4, x - 3 : x + 4], GREEN).sum() > 20 for step in range(STEPS)]
    assert lit == [passed < step <= passed + 5 for step in range(STEPS)]


def test_only_the_end_says_how_the_episode_ended(pictures):
    title = pictures[:, :50, 600:890]
    shown = [like(picture, VERMILLION).any() for picture in title]
    assert shown == [False] * (2 * STEPS) + [True] * 21


def test_on_a_large_track_the_camera_follows_the_car_and_a_small_map_shows_where_it_is(trace, tmp_path):
    path = tmp_path / "episode.mp4"
    write_video(path, enlarged(trace, 20), "a small drive")
    with av.open(path) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    for picture in (pictures[0], pictures[14], pictures[27]):
        assert car_in(picture[:, 300:900]) == pytest.approx(MIDDLE - (300, 0), abs=2)
        assert like(picture[568:704, 16:220], YELLOW).sum() > 20


def test_between_two_steps_the_car_is_on_the_arc_that_joins_them(trace):
    turn, radius = 0.5, 8.0
    headings = turn * np.arange(STEPS + 1)
    circle = np.column_stack([radius * np.sin(headings), -radius * np.cos(headings), headings])
    motion = motion_of(changed(trace, state=circle[:-1], next_state=circle[1:]), rate=70)
    assert np.linalg.norm(motion.poses[:, :2], axis=1) == pytest.approx(radius)
    angles = np.unwrap(np.arctan2(motion.poses[:, 1], motion.poses[:, 0])) + np.pi / 2
    assert angles == pytest.approx(motion.poses[:, 2])
    assert np.diff(angles) == pytest.approx(turn / 7)


def test_a_heading_that_wraps_around_turns_the_short_way(trace):
    state = np.array(trace.columns["state"], dtype=np.float64)
    state[:2, 2] = np.pi - 0.1, -np.pi + 0.1
    motion = motion_of(changed(trace, state=state), rate=20)
    assert motion.poses[1, 2] == pytest.approx(np.pi)


def test_a_ray_that_leaves_one_wall_for_another_is_never_drawn_between_them(trace):
    readings = np.full((STEPS, 5), 0.2, dtype=np.float32)
    readings[0, 0], readings[1, 0], readings[0, 1] = 0.9, 0.3, 0.3
    motion = motion_of(changed(trace, observation=readings), rate=40)
    assert motion.ranges[:5, 0] == pytest.approx([9, 9, 3, 3, 3])
    assert motion.ranges[:5, 1] == pytest.approx([3, 2.75, 2.5, 2.25, 2])


@pytest.mark.parametrize("time_step", [0.02, 0.1, 0.3])
def test_a_video_has_the_speed_of_the_car_whatever_the_time_step(trace, time_step):
    motion = motion_of(EpisodeTrace(replace(trace.scene, time_step=time_step), trace.columns), rate=30)
    assert len(motion) == pytest.approx(STEPS * time_step * 30 + 1, abs=1)
    assert (np.diff(motion.steps + motion.shares) > 0).all()
    assert (motion.steps[-1], motion.shares[-1]) == (STEPS - 1, 1)


def test_q_values_that_went_out_of_bounds_do_not_stop_the_video(trace, tmp_path):
    values = trace.columns["action_value"].copy()
    values[2], values[3, 0], values[4] = np.nan, -np.inf, 1e30
    path = tmp_path / "episode.gif"
    write_video(path, changed(trace, action_value=values), "a small drive")
    with Image.open(path) as image:
        assert image.n_frames == 49


def test_where_the_log_lacks_steps_the_car_stays_until_the_next_one(trace):
    kept = [0, 1, 9, 10]
    part = EpisodeTrace(trace.scene, {name: values[kept] for name, values in trace.columns.items()})
    motion = motion_of(part, rate=20)
    assert motion.poses[:4, 0] == pytest.approx([10, 10.75, 11.5, 11.5])
    assert motion.poses[4] == pytest.approx(trace.poses[9])


def test_the_palette_of_a_gif_has_room(trace):
    assert len(gif_palette()) <= 256


def test_progress_counts_the_pictures_that_are_drawn(trace, tmp_path):
    calls = []
    write_video(tmp_path / "episode.gif", trace, "a small drive", progress=lambda done, of: calls.append((done, of)))
    assert calls == [(done, 29) for done in range(1, 30)]


def test_a_failure_on_the_way_leaves_the_old_file_and_no_other(trace, tmp_path):
    def fail(done, of):
        if done == 10:
            raise KeyboardInterrupt

    path = tmp_path / "episode.mp4"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        write_video(path, trace, "a small drive", progress=fail)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_that_is_no_video_is_refused(trace, tmp_path):
    with pytest.raises(CarrlError, match=r"'.*episode.avi' is no name of a video; it must end in \.mp4 or \.gif"):
        write_video(tmp_path / "episode.avi", trace, "a small drive")


def test_a_folder_that_is_missing_is_found_out_before_anything_is_drawn(trace, tmp_path):
    drawn = []
    with pytest.raises(CarrlError, match=r"cannot be written: there is no folder '.*nowhere'"):
        write_video(tmp_path / "nowhere" / "episode.gif", trace, "a drive", progress=lambda *at: drawn.append(at))
    assert not drawn


def test_without_pyav_the_error_says_what_to_install(trace, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(CarrlError, match=r"pip install 'carrl\[export\]'"):
        write_video(tmp_path / "episode.mp4", trace, "a small drive")


def test_a_video_is_written_without_torch():
    code = "import sys, carrl.render.video; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_the_panel_of_a_car_with_pedals_has_a_bar_for_each_control_and_its_speed(pedals, tmp_path):
    write_video(tmp_path / "episode.mp4", pedals, "pedals")
    with av.open(tmp_path / "episode.mp4") as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    throttle, brake = (like(pictures[2 * step][150:190, 1015:1175], colour).sum() for step, colour in PEDALLED)
    assert throttle > 600 and brake > 600
    left = like(pictures[2 * 4][120:150, 1015:1175], BLUE)
    right = like(pictures[2 * 7][120:150, 1015:1175], BLUE)
    assert left[:, :80].sum() > 600 > 20 > left[:, 82:].sum()  # to the left is at the left
    assert right[:, 80:].sum() > 300 > 20 > right[:, :78].sum()
    shades = {tuple(rgb(shade)) for shade in LIGHT.speed_shades}
    scale = pictures[6][190:260, 1100:1256].reshape(-1, 3).astype(int)
    assert sum(np.abs(scale - shade).max(axis=1).min() < 16 for shade in shades) == len(shades)
