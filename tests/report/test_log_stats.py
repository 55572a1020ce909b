"""The statistics of a log: sums worked by hand, sections of a square track, and what is printed and drawn of them."""

import io
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from rich.console import Console

from carrl.cli.text.log_stats_text import print_log_stats
from carrl.errors import CarrlError, LogError
from carrl.log.messages import Episode
from carrl.render.colours import BLACK, BLUE, VERMILLION, YELLOW
from carrl.render.terminal import histogram
from carrl.report.log_stats import LogStats, crowding, section_name, sections_at, stations_near
from carrl.report.log_stats_figure import draw_log_stats
from tests.operations import count_calls

ACTION_COUNTS = np.array([600, 300, 100])
SQUARE = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], dtype=np.float64)


def episode(number, end, ended="collision", track=0, **others):
    values = {"episode_return": -200.0, "length": 10, "gates": 0, "laps": 0} | others
    ends_at = {"frame": 10 * number, "begin_ns": 0, "end_ns": 0, "end_pose": (*end, 0.0)}
    return Episode(episode=number, env=0, track=track, ended=ended, **ends_at, **values)


EPISODES = [
    episode(0, (19.5, 3.0)),
    episode(1, (19.5, 2.0), length=20),
    episode(2, (0.5, 3.0), episode_return=100.0, length=35, gates=3),
    episode(3, (10.0, 3.0), ended="time limit", episode_return=400.0, length=99, gates=9, laps=2),
]
"""Two crashes between the start and gate 1 of the fixture's track, one before the start, and two laps."""


@pytest.fixture
def stats(scene):
    return LogStats.of(EPISODES, scene, ACTION_COUNTS, 0.25)


def printed(stats, width=80, colours=False):
    file = io.StringIO()
    print_log_stats(
        stats,
        Console(file=file, width=width, force_terminal=colours, color_system="truecolor" if colours else None),
    )
    return file.getvalue()


def pixels_of(path, colour):
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    return int((np.abs(pixels - np.round(255 * np.array(to_rgb(colour)))).max(axis=-1) <= 6).sum())


def bar_of(text, name):
    """Count and share at the end of the line that begins with this name."""
    found = re.search(rf"^ *{re.escape(name)} .*? ([\d,]+) +(<?\d+) %", text, re.MULTILINE)
    return found and (int(found[1].replace(",", "")), found[2])


def test_crashes_are_counted_by_the_section_they_happened_in(stats):
    assert stats.crashes.tolist() == [0, 1, 2]
    assert stats.crashes_by_section.tolist() == [2, 0, 0, 1]


def test_sections_are_called_by_the_gates_at_their_ends():
    assert [section_name(section, 3) for section in range(3)] == ["start to 1", "1 to 2", "2 to start"]


def test_a_station_is_the_distance_along_the_centreline_to_the_nearest_point_of_it():
    places = np.array([(3.0, 0.5), (9.0, 4.0), (12.0, 10.0), (2.0, 9.0), (-1.0, 6.0), (0.5, 0.2)])
    assert stations_near(SQUARE, places) == pytest.approx([3, 14, 20, 28, 34, 0.5])


def test_the_nearest_point_is_found_as_by_trying_all_of_them():
    generator = np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    centreline = np.column_stack([5_000 + 300 * np.cos(angles), 100 * np.sin(2 * angles) - 3_000])
    places = centreline[generator.integers(90, size=100)] + generator.normal(0, 4, (100, 2))
    ends = np.roll(centreline, -1, axis=0)
    shares = np.linspace(0, 1, 1_001)[:, None, None]
    fine = (centreline + shares * (ends - centreline)).transpose(1, 0, 2).reshape(-1, 2)
    lengths = np.linalg.norm(ends - centreline, axis=1)
    stations = (np.append(0, lengths.cumsum()[:-1])[:, None] + np.linspace(0, 1, 1_001) * lengths[:, None]).ravel()
    slow = np.array([stations[((fine - place) ** 2).sum(axis=1).argmin()] for place in places])
    difference = np.abs(stations_near(centreline, places) - slow)
    assert np.minimum(difference, lengths.sum() - difference).max() < 0.1


def test_a_section_ends_at_its_gate(track_shape):
    x, y = track_shape.gates[0].mean(axis=0)  # of gate 1, which is crossed northwards
    assert sections_at(track_shape, np.array([(x, y - 0.2), (x, y + 0.2)])).tolist() == [0, 1]


def test_crowding_counts_the_places_of_one_square():
    places = np.array([(0.1, 0.1), (-0.2, 0.3), (5.0, 5.0), (0.4, -0.4)])
    assert crowding(places, side=1.0).tolist() == [3, 3, 1, 3]


def test_the_text_has_the_sums_of_the_log(stats):
    text = printed(stats)
    assert "4 episodes ended: 3 by collision (75 %), 1 by the time limit (25 %)" in text
    assert "2 laps, in 1 episode (25 %)" in text
    assert "1,000 transitions, 25 % of them drawn at random" in text
    assert [bar_of(text, name) for name in ("forward", "left", "right")] == [(600, "60"), (300, "30"), (100, "10")]
    assert bar_of(text, "start to 1") == (2, "67")
    assert bar_of(text, "4 to start") is None
    assert bar_of(text, "3 to start") == (1, "33")
    assert "where cars crashed on square" in text


def test_the_longest_bar_belongs_to_the_greatest_count(stats):
    lines = {line.split()[0]: line.count("█") for line in printed(stats).splitlines() if "█" in line}
    assert lines["forward"] == pytest.approx(2 * lines["left"], abs=1)


def test_a_histogram_has_round_intervals_that_hold_every_value():
    file = io.StringIO()
    values = np.array([-200.0, -120.0, 0.0, 99.0, 400.0])
    Console(file=file, width=60, color_system=None).print(histogram("returns", values, 60))
    intervals = [bar_of(file.getvalue(), f"{low} to {low + 100}") for low in range(-200, 500, 100)]
    assert [count for count, _ in intervals] == [2, 0, 2, 0, 0, 0, 1]


@pytest.mark.parametrize("values", [np.array([7, 7, 7]), np.array([7]), np.array([3, 4, 5]), np.array([0.0, 0.0])])
def test_a_histogram_of_hardly_different_values_is_drawn(values):
    file = io.StringIO()
    Console(file=file, width=60, color_system=None).print(histogram("values", values, 60))
    counts = [int(count) for count in re.findall(r" (\d+) +\d+ %", file.getvalue())]
    assert sum(counts) == len(values)


@pytest.mark.parametrize("width", [60, 80, 119, 120, 200])
def test_nothing_is_wider_than_the_console(stats, width):
    assert max(map(len, printed(stats, width).splitlines())) <= width


def test_plain_text_has_no_control_codes(stats):
    assert "\x1b" not in printed(stats)
    assert "\x1b" in printed(stats, colours=True)


def test_a_log_without_an_ended_episode_says_so_and_still_shows_the_actions(scene, tmp_path):
    stats = LogStats.of([], scene, ACTION_COUNTS, 0.25)
    text = printed(stats)
    assert "no episode has ended in this log" in " ".join(text.split())
    assert bar_of(text, "forward") == (600, "60")
    with pytest.raises(CarrlError, match="no episode has ended in this log"):
        draw_log_stats(tmp_path / "stats.png", stats, "a log")
    assert not list(tmp_path.iterdir())


def test_a_log_without_anything_is_no_crash(scene):
    assert "0 transitions" in printed(LogStats.of([], scene, np.zeros(3, dtype=np.int64), 0.0))


def test_episodes_that_cannot_be_are_refused_in_one_sentence(scene):
    with pytest.raises(LogError, match="on a track that is not attached"):
        LogStats.of([episode(0, (3, 3), track=1)], scene, ACTION_COUNTS, 0.0)
    with pytest.raises(LogError, match="no number"):
        LogStats.of([episode(0, (3, 3), episode_return=float("nan"))], scene, ACTION_COUNTS, 0.0)


def test_without_crashes_there_is_no_map_of_them(scene, tmp_path):
    stats = LogStats.of(EPISODES[3:], scene, ACTION_COUNTS, 0.25)
    assert "where cars crashed" not in printed(stats)
    draw_log_stats(tmp_path / "stats.png", stats, "a log")
    assert pixels_of(tmp_path / "stats.png", BLUE) > 500


def test_of_many_tracks_the_most_driven_one_is_mapped_and_the_text_says_so(scene, track_shape, tmp_path):
    scene = replace(scene, tracks=(track_shape, replace(track_shape, name="other")))
    stats = LogStats.of([*EPISODES, *(episode(n, (3, 3), track=1) for n in range(4, 10))], scene, ACTION_COUNTS, 0.25)
    assert stats.track.name == "other"
    assert len(stats.crashes) == 6
    assert "where cars crashed on other, the track of most episodes, 6 of 10" in " ".join(printed(stats).split())


def test_the_figure_shows_actions_ends_and_crashes_in_their_colours(stats, tmp_path):
    path = tmp_path / "stats.png"
    draw_log_stats(path, stats, "a log")
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert image.size[0] == 910
    assert min(pixels_of(path, colour) for colour in (BLACK, VERMILLION)) > 5_000
    assert pixels_of(path, BLUE) > 1_000
    assert list(tmp_path.iterdir()) == [path]


def test_the_colour_of_a_crash_tells_how_many_there_were(scene, tmp_path):
    lonely, crowded = (
        LogStats.of([episode(n, (19.5, 3.0)) for n in range(count)], scene, ACTION_COUNTS, 0.0) for count in (1, 50)
    )
    for name, stats in (("lonely", lonely), ("crowded", crowded)):
        draw_log_stats(tmp_path / f"{name}.png", stats, "a log")
    pale, dark = (pixels_of(tmp_path / f"{name}.png", "#3d0c00") for name in ("lonely", "crowded"))
    assert dark > pale
    assert pixels_of(tmp_path / "crowded.png", YELLOW) > 0  # of the scale below


def test_a_hundred_thousand_episodes_are_a_few_calls_each(scene):
    generator = np.random.default_rng(0)
    ends = np.column_stack([generator.choice([0.5, 19.5], 100_000), generator.uniform(0, 20, 100_000)]).tolist()
    episodes = [episode(number, end, length=number % 200 + 1) for number, end in enumerate(ends)]
    found = []
    assert count_calls(lambda: found.append(LogStats.of(episodes, scene, ACTION_COUNTS, 0.25))) < 1_000_000
    assert found[0].crashes_by_section.sum() == 100_000
    assert count_calls(lambda: printed(found[0])) < 100_000


def test_statistics_are_printed_without_torch_and_matplotlib_and_drawn_without_torch():
    code = (
        "import sys, carrl.cli.text.log_stats_text; light = {'torch', 'matplotlib'}.isdisjoint(sys.modules);"
        "import carrl.report.log_stats_figure; sys.exit(not light or 'torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_ends_that_no_wall_brought_are_counted_by_themselves(scene, tmp_path):
    stopped = [episode(4, (10.0, 3.0), ended="other end"), episode(5, (10.0, 3.0), ended="other end")]
    stats = LogStats.of([*EPISODES, *stopped], scene, ACTION_COUNTS, 0.25)
    assert stats.ends_counted == {"collision": 3, "time limit": 1, "other end": 2}
    assert stats.crashes.tolist() == [0, 1, 2]
    words = "6 episodes ended: 3 by collision (50 %), 1 by the time limit (17 %), 2 by another end (33 %)"
    assert words in printed(stats, width=120)
    draw_log_stats(tmp_path / "stats.png", stats, "a log")
    assert (tmp_path / "stats.png").exists()
