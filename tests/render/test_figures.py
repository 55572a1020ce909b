"""The PNGs are whole, of a sensible size, and show what they say: checked by the colours of their pixels."""

import os

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb
from PIL import Image

from carrl.errors import CarrlError
from carrl.render import round_number
from carrl.render.canvas import PixelCanvas
from carrl.render.car import ray_ends
from carrl.render.colours import BLACK, BLUE, GREEN, LIGHT, VERMILLION, YELLOW, rgb
from carrl.render.curves import (
    DOT,
    DPI,
    EvaluationCurve,
    RunCurve,
    block_centres,
    block_means,
    common_bounds,
    draw_learning_curve,
    draw_learning_curves,
    new_figure,
    save_figure,
)
from carrl.render.lap import draw_lap, prevailing_actions
from carrl.render.track_map import TrackMap, draw_track_map
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track
from tests.sim.steering import LEFT, steer


def pixels_of(path, colour, tolerance=6):
    """How many pixels of the PNG have this colour."""
    with Image.open(path) as image:
        assert image.format == "PNG"
        pixels = np.asarray(image.convert("RGB")).astype(int)
    difference = np.abs(pixels - np.round(np.array(to_rgb(colour)) * 255).astype(int))
    return int((difference.max(axis=-1) <= tolerance).sum())


def size_of(path):
    with Image.open(path) as image:
        image.load()  # raises for half a file
        return image.size


def noisy_returns(episodes, seed=0):
    generator = np.random.default_rng(seed)
    return (np.linspace(-200, 380, episodes) + generator.normal(0, 80, episodes)).tolist()


def drive(track, choose, steps=400):
    """Poses [T + 1, 3], ranges [T, R], actions [T] and whether it ended at a wall."""
    simulator = Simulator(track, Vehicle(), Sensor(max_range=10.0))
    state = simulator.start(torch.zeros(1))
    poses, ranges, actions = [state.pose], [], []
    for step in range(steps):
        ranges.append(simulator.sense(state))
        actions.append(choose(step, ranges[-1]))
        outcome = simulator.step(state, steer(actions[-1]))
        state = outcome.cars
        poses.append(state.pose)
        if outcome.collided or state.gates_passed >= track.gate_count:
            break
    return torch.cat(poses).numpy(), torch.cat(ranges).numpy(), torch.cat(actions).numpy(), bool(outcome.collided)


def rule(_, ranges):
    """Steers to the side whose rays are longer in sum."""
    middle = ranges.shape[1] // 2
    difference = ranges[:, middle + 1 :].sum(1) - ranges[:, :middle].sum(1)
    return torch.where(difference > 0.5, 1, torch.where(difference < -0.5, 2, 0))


def draw(path, track, poses, ranges, actions, **options):
    angles = Sensor().angles.numpy()
    names = ("forward", "left", "right")
    draw_lap(
        path,
        track,
        poses,
        ranges,
        angles,
        actions,
        action_names=names,
        body_radius=0.5,
        sensor_range=10.0,
        title="a drive",
        **options,
    )


@pytest.fixture(scope="module")
def paper():
    return Track.load("paper")


@pytest.fixture(scope="module")
def lap(paper):
    poses, ranges, actions, collided = drive(paper, rule)
    assert not collided
    return poses, ranges, actions


def test_block_means_by_hand():
    np.testing.assert_allclose(block_means([1, 2, 3, 10, 20, 30], 3), [2, 20])


def test_a_last_block_may_be_shorter_and_is_not_dropped():
    np.testing.assert_allclose(block_means([1, 2, 3, 10, 20], 3), [2, 15])


def test_an_incomplete_block_counts_if_it_is_the_only_one():
    np.testing.assert_allclose(block_means([1, 2], 3), [1.5])


def test_no_episode_has_no_block():
    assert block_means([], 3).shape == (0,)


def test_blocks_stand_in_the_middle_of_their_episodes():
    np.testing.assert_allclose(block_centres(45, 20), [10.5, 30.5, 43])


def test_bounds_leave_out_a_freak_episode_but_no_block_mean():
    returns = [0.0] * 500 + [-300.0] * 500
    bounds = common_bounds([RunCurve([*returns[:999], -20_000.0])], window=500)
    assert -400 < bounds.low < -300
    assert bounds.outside
    assert not common_bounds([RunCurve(returns)], window=500).outside


@pytest.mark.parametrize("episodes", [0, 1, 20, 300, 3000])
def test_learning_curve_of_any_length(tmp_path, episodes):
    draw_learning_curve(tmp_path / "curve.png", noisy_returns(episodes))
    assert size_of(tmp_path / "curve.png") == (910, 468)
    means = pixels_of(tmp_path / "curve.png", BLUE)
    assert means > (300 if episodes >= 300 else 0)
    assert pixels_of(tmp_path / "curve.png", VERMILLION) == 0


def test_learning_curve_of_equal_returns(tmp_path):
    draw_learning_curve(tmp_path / "curve.png", [-220.0] * 50)
    assert pixels_of(tmp_path / "curve.png", BLUE) > 100


@pytest.mark.parametrize("first_lap", [0, 150, 300])
def test_first_lap_is_marked(tmp_path, first_lap):
    draw_learning_curve(tmp_path / "curve.png", noisy_returns(300), first_lap_episode=first_lap)
    assert pixels_of(tmp_path / "curve.png", VERMILLION, tolerance=60) > 250


def test_evaluations_stand_beside_the_returns_with_filled_marks_where_every_lap_was_completed(tmp_path):
    def draw(laps, first_lap_frame=None):
        curve = EvaluationCurve([0, 500, 1000, 1500], [-200.0, 50.0, 400.0, 400.0], laps, "reward", first_lap_frame)
        draw_learning_curve(tmp_path / "curve.png", noisy_returns(60), evaluations=curve)
        assert size_of(tmp_path / "curve.png") == (910, 468)
        return pixels_of(tmp_path / "curve.png", BLUE), pixels_of(tmp_path / "curve.png", VERMILLION, tolerance=60)

    none, lapped, marked = draw([0.0] * 4), draw([0, 0.5, 1, 1]), draw([0, 0.5, 1, 1], first_lap_frame=1000)
    assert lapped[0] > none[0] + 60
    assert (none[1], lapped[1]) == (0, 0)
    assert marked[1] > 250


def test_one_evaluation_is_no_curve(tmp_path):
    curve = EvaluationCurve([1500], [400.0], [1.0], "reward")
    draw_learning_curve(tmp_path / "with.png", noisy_returns(60), evaluations=curve)
    draw_learning_curve(tmp_path / "without.png", noisy_returns(60))
    assert (tmp_path / "with.png").read_bytes() == (tmp_path / "without.png").read_bytes()


def test_single_returns_are_drawn_behind_the_means(tmp_path):
    draw_learning_curve(tmp_path / "curve.png", noisy_returns(300), window=1000)
    faint = np.array(to_rgb(DOT)) * 0.45 + 0.55
    assert pixels_of(tmp_path / "curve.png", tuple(faint)) > 300


@pytest.mark.parametrize("count", [1, 2, 10, 11])
def test_small_multiples_of_any_number(tmp_path, count):
    runs = {f"seed={seed},$x_{seed}": RunCurve(noisy_returns(60 * seed, seed)) for seed in range(count)}
    draw_learning_curves(tmp_path / "curves.png", runs)
    width, height = size_of(tmp_path / "curves.png")
    assert width == 910
    assert 300 < height < 1200
    assert pixels_of(tmp_path / "curves.png", BLUE) > 0


def test_small_multiples_show_which_runs_lapped(tmp_path):
    returns = noisy_returns(100)
    draw_learning_curves(tmp_path / "none.png", {"a": RunCurve(returns), "b": RunCurve(returns)})
    draw_learning_curves(tmp_path / "one.png", {"a": RunCurve(returns), "b": RunCurve(returns, 40)})
    assert pixels_of(tmp_path / "none.png", VERMILLION) == 0
    assert pixels_of(tmp_path / "one.png", VERMILLION) > 100


def test_no_run_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least one"):
        draw_learning_curves(tmp_path / "curves.png", {})


def test_ray_ends_by_hand():
    ends = ray_ends(np.array([1.0, 2.0, np.pi / 2]), np.array([3.0, 4.0]), np.array([0.0, np.pi / 2]))
    np.testing.assert_allclose(ends, [[1, 5], [-3, 2]], atol=1e-12)


def test_prevailing_actions_by_hand():
    actions = np.array([1, 2, 1, 0, 0, 2, 2])
    np.testing.assert_array_equal(prevailing_actions(actions, 3), [1, 1, 1, 0, 0, 0, 2])
    np.testing.assert_array_equal(prevailing_actions(actions, 1), actions)


@pytest.mark.parametrize(("least", "expected"), [(0.3, 0.5), (1, 1), (3, 5), (5.1, 10), (140, 200), (1000, 1000)])
def test_round_numbers(least, expected):
    assert round_number(least) == pytest.approx(expected)


def test_a_lap_shows_road_gates_line_rays_and_cars(tmp_path, paper, lap):
    draw(tmp_path / "lap.png", paper, *lap)
    width, height = size_of(tmp_path / "lap.png")
    assert width == 910
    assert 500 < height < 1000
    assert pixels_of(tmp_path / "lap.png", LIGHT.road) > 50_000
    for colour in (*LIGHT.action_colours(3), GREEN, YELLOW):
        assert pixels_of(tmp_path / "lap.png", colour) > 50


def test_an_action_that_was_never_chosen_is_in_the_legend_only(tmp_path, paper, lap):
    poses, ranges, actions = lap
    draw(tmp_path / "both.png", paper, poses, ranges, actions)
    draw(tmp_path / "left.png", paper, poses, ranges, np.full_like(actions, LEFT))
    assert pixels_of(tmp_path / "both.png", BLUE) > 2 * pixels_of(tmp_path / "left.png", BLUE)


def test_gates_are_white_lines_across_the_road(tmp_path, paper):
    draw_track_map(tmp_path / "map.png", paper, "paper")
    with Image.open(tmp_path / "map.png") as image:
        picture = np.asarray(image)
    view = TrackMap(paper, "paper").view
    for gate in paper.gates[:-1].double().numpy():
        column, row = np.round(view.places(0.7 * gate[0] + 0.3 * gate[1]) * DPI / 72).astype(int)
        assert picture[row - 1 : row + 2, column - 1 : column + 2].max() == rgb(LIGHT.gate).red


@pytest.mark.parametrize("ending", ["pdf", "svg"])
def test_a_map_and_a_lap_are_drawn_as_paths_too(tmp_path, paper, lap, ending):
    for name in ("a", "b"):
        draw_track_map(tmp_path / f"{name}.{ending}", paper, "paper")
    draw(tmp_path / f"lap.{ending}", paper, *lap)
    assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()
    assert os.path.getsize(tmp_path / f"lap.{ending}") > os.path.getsize(tmp_path / f"a.{ending}") > 10_000


def test_a_crash_ends_with_a_cross(tmp_path, paper):
    poses, ranges, actions, collided = drive(paper, lambda step, _: torch.tensor([step // 4 % 3]))
    assert collided
    draw(tmp_path / "crash.png", paper, poses, ranges, actions, collided=True)
    draw(tmp_path / "end.png", paper, poses, ranges, actions, collided=False)
    assert pixels_of(tmp_path / "crash.png", BLACK) > pixels_of(tmp_path / "end.png", BLACK) + 100


@pytest.mark.parametrize("steps", [0, 1, 5])
def test_the_shortest_drives(tmp_path, paper, lap, steps):
    poses, ranges, actions = lap
    draw(tmp_path / "short.png", paper, poses[:steps], ranges[:steps], actions[:steps])
    assert pixels_of(tmp_path / "short.png", LIGHT.road) > 50_000


def long_circuit(tmp_path):
    """A circle of 600 m radius as a file."""
    angle = np.arange(0, 2 * np.pi, 0.01)[:, None]
    rows = np.hstack([600 * np.cos(angle), 600 * np.sin(angle), np.full((len(angle), 2), 5.0)])
    header = "# x_m,y_m,w_tr_right_m,w_tr_left_m"
    np.savetxt(tmp_path / "circle.csv", rows, delimiter=",", header=header, comments="")
    return Track.load(tmp_path / "circle.csv")


def test_a_long_circuit_gets_a_close_up_and_a_short_one_does_not(tmp_path, paper):
    circle = long_circuit(tmp_path)
    track_map, places = TrackMap(circle, "circle"), circle.centreline.double().numpy()[:1]
    close_up = track_map.close_up(places)
    assert close_up is not None
    assert close_up.scale > 1.5 > track_map.view.scale
    assert TrackMap(paper, "paper").close_up(paper.centreline.double().numpy()[:1]) is None


def test_rays_are_visible_on_a_long_circuit(tmp_path):
    circle = long_circuit(tmp_path)
    draw(tmp_path / "lap.png", circle, *drive(circle, rule, steps=60)[:3])
    assert pixels_of(tmp_path / "lap.png", GREEN, tolerance=40) > 100


def test_a_failed_write_keeps_the_old_picture_and_leaves_nothing_beside_it(tmp_path, monkeypatch):
    path = tmp_path / "curve.png"
    draw_learning_curve(path, noisy_returns(20))
    before = path.read_bytes()

    def refuse(*_):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(CarrlError, match="no space left"):
        draw_learning_curve(path, noisy_returns(40))
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["curve.png"]


def test_the_same_figure_gives_the_same_bytes(tmp_path):
    for name in ("a.png", "b.png"):
        save_figure(new_figure(height=1.0), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_the_arrow_of_a_start_in_a_corner_points_along_the_road(tmp_path):
    points = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 50.0], [0.0, 50.0]])
    track = Track.from_centreline("square", Centreline(points, *np.full((2, 4), 4.0)))
    draw_track_map(tmp_path / "map.png", track, "square")
    with Image.open(tmp_path / "map.png") as image:
        dark = np.asarray(image.convert("L")) < 100
    # Of the rows beside the start, that of the shaft has the longest stretch of dark pixels.
    left, top = np.round(
        (TrackMap(track, "square").view.places(track.gates[-1].double().numpy())).mean(axis=0) * DPI / 72
    )
    around = dark[int(top) - 60 : int(top) + 60, int(left) - 40 : int(left) + 80]
    assert around.sum(axis=1).max() > 35


def test_a_line_by_speed_has_a_bar_of_its_colours_instead_of_actions(tmp_path, paper, lap):
    poses = lap[0]
    speeds = np.linspace(5.0, 25.0, len(poses))
    draw(tmp_path / "speed.png", paper, *lap, speeds=speeds)
    draw(tmp_path / "steady.png", paper, *lap, speeds=np.full(len(poses), 10.0))
    draw(tmp_path / "action.png", paper, *lap)
    by_speed, steady, by_action = (read_pixels(tmp_path / f"{name}.png") for name in ("speed", "steady", "action"))
    shades = [count_of(by_speed, shade) for shade in LIGHT.speed_shades]
    assert min(shades) > 20  # the bar has them all
    assert count_of(by_speed, LIGHT.actions[1]) == 0 < count_of(by_action, LIGHT.actions[1])
    np.testing.assert_array_equal(steady, by_action)


def test_a_drive_by_numbers_needs_no_names(tmp_path, paper, lap):
    poses, ranges, actions = lap
    draw_lap(
        tmp_path / "numbers.png",
        paper,
        poses,
        ranges,
        Sensor().angles.numpy(),
        np.zeros((len(actions), 2), dtype=np.float32),
        action_names=(),
        body_radius=0.8,
        body_size=(4.0, 1.6),
        sensor_mount=1.0,
        sensor_range=10.0,
        title="a drive",
    )
    assert count_of(read_pixels(tmp_path / "numbers.png"), LIGHT.car) > 100


def test_rays_begin_at_their_mount():
    ends = ray_ends(np.array([1.0, 2.0, np.pi / 2]), np.array([3.0]), np.array([0.0]), mount=0.5)
    np.testing.assert_allclose(ends, [[1.0, 5.5]], atol=1e-12)


def read_pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def count_of(pixels, colour):
    return int((np.abs(pixels - rgb(colour)).max(axis=-1) <= 2).sum())


def test_a_table_of_actions_shows_as_many_in_the_legend_as_there_is_room_for(tmp_path, paper, lap):
    poses, ranges, actions = lap
    names = [f"steer {row / 10:+g} pedal {row:+g}" for row in range(40)]
    often = np.where(actions == 1, 37, actions)
    options = {"body_radius": 0.5, "sensor_range": 10.0, "title": "a table", "action_names": names}
    draw_lap(tmp_path / "table.png", paper, poses, ranges, Sensor().angles.numpy(), often, **options)
    colours = LIGHT.action_colours(len(names))
    legend = read_pixels(tmp_path / "table.png")[-40:]
    assert count_of(legend, colours[37]) > 20  # the most frequent one
    assert count_of(legend[:, :240], LIGHT.ink) < 200  # the scale bar stands there alone


def test_words_beside_the_canvas_are_not_drawn():
    canvas = PixelCanvas(60, 40)
    canvas.clear(LIGHT.ink)
    for place in ((-500, 20), (500, 20), (20, -500), (20, 500)):
        canvas.text(place, "beside", 10, LIGHT.car)
    assert (canvas.picture() == canvas.picture()[0, 0]).all()
