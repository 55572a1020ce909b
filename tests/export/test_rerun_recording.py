"""The recording for Rerun holds the episode, step by step, and the viewer draws it the right way up."""

import importlib
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from carrl.errors import CarrlError
from carrl.log.trace import EpisodeTrace
from carrl.render.colours import DARK, rgb
from tests.driven_episode import MOUNT
from tests.export.headless_viewer import headless_viewer, save_screenshot

pytest.importorskip("rerun", reason="rerun-sdk is not installed")

from carrl.export.rerun import open_recording, write_recording

CAR, GROUND, RAY, WALL = (rgb(colour) for colour in (DARK.car, DARK.ground, DARK.ray, DARK.wall))
ACTIONS = [rgb(colour) for colour in DARK.actions]


class Recording:
    """What an .rrd file holds: `steps[entity]` and `rows[entity][component]`, and the same of the blueprint."""

    def __init__(self, path):
        from rerun.chunk import RrdReader

        self._reader = RrdReader(path)
        (self.store,) = self._reader.recordings()
        (blueprint,) = self._reader.blueprints()
        self.steps, self.times, self.rows = {}, {}, {}
        for chunk in self._reader.stream():
            self._add(chunk)
        self.layout = [self._components(chunk) for chunk in self._reader.stream(store=blueprint)]

    def _add(self, chunk):
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            self.steps[chunk.entity_path] = batch.column("step").to_pylist()
            self.times[chunk.entity_path] = batch.column("time").cast("int64").to_pylist()
        self.rows.setdefault(chunk.entity_path, {}).update(self._components(chunk))

    @staticmethod
    def _components(chunk):
        batch = chunk.to_record_batch()
        indexes = {"step", "time", "blueprint", "log_time", "log_tick", "rerun.controls.RowId"}
        return {name: batch.column(name).to_pylist() for name in batch.schema.names if name not in indexes}


@pytest.fixture(scope="module")
def path(trace, tmp_path_factory):
    path = tmp_path_factory.mktemp("rerun") / "episode.rrd"
    write_recording(path, trace, "an episode")
    return path


@pytest.fixture(scope="module")
def recording(path):
    return Recording(path)


def rewritten(trace, tmp_path, **columns):
    other = EpisodeTrace(trace.scene, {**trace.columns, **columns})
    write_recording(tmp_path / "other.rrd", other, "another")
    return Recording(tmp_path / "other.rrd")


def packed(colour):
    return int.from_bytes(bytes((*colour, 255)), "big")


def test_the_car_and_its_rays_are_where_the_log_has_them(recording, trace):
    car, rays = recording.rows["/car/body"], recording.rows["/car/rays"]
    np.testing.assert_allclose(np.array(car["Points2D:positions"])[:, 0], trace.poses[:, :2], rtol=1e-6)
    np.testing.assert_allclose(np.array(car["Arrows2D:origins"])[:, 0], trace.poses[:, :2], rtol=1e-6)
    vectors = np.array(car["Arrows2D:vectors"])[:, 0]
    np.testing.assert_allclose(np.arctan2(vectors[:, 1], vectors[:, 0]), trace.poses[:, 2], atol=1e-6)
    strips = np.array(rays["LineStrips2D:strips"])
    np.testing.assert_allclose(strips[:, :, 1], trace.ray_ends(), rtol=1e-5)
    np.testing.assert_allclose(strips[:, :, 0], np.repeat(trace.poses[:, None, :2], 5, axis=1), rtol=1e-6)


def test_only_rays_that_meet_a_wall_end_in_a_dot(recording, trace):
    dots = recording.rows["/car/rays"]["Points2D:positions"]
    assert [len(row) for row in dots] == (trace.ranges < 10).sum(axis=1).tolist()
    assert 0 < sum(map(len, dots)) < trace.ranges.size


def test_the_way_of_a_step_appears_once_it_is_driven_in_the_colour_of_its_action(recording, trace):
    trail = recording.rows["/car/trail"]
    assert recording.steps["/car/trail"] == list(range(1, 15))
    ways = np.array(trail["LineStrips2D:strips"])[:, 0]
    np.testing.assert_allclose(ways, np.stack([trace.poses[:-1, :2], trace.poses[1:, :2]], axis=1), rtol=1e-6)
    assert [row[0] for row in trail["LineStrips2D:colors"]] == [packed(ACTIONS[action]) for action in trace.actions]


def test_other_cars_are_where_the_log_has_them(among_others, recording, tmp_path):
    write_recording(tmp_path / "others.rrd", among_others, "others")
    others = Recording(tmp_path / "others.rrd")
    body = others.rows["/other_cars/body"]
    assert others.steps["/other_cars/body"] == list(range(15))
    np.testing.assert_allclose(np.array(body["Points2D:positions"])[:, ::2], among_others.others[..., :2], rtol=1e-6)
    vectors = np.array(body["Arrows2D:vectors"])
    headings = np.arctan2(vectors[..., 1], vectors[..., 0])
    np.testing.assert_allclose(np.cos(headings - among_others.others[..., 2]), 1, rtol=1e-6)
    assert body["Points2D:colors"][0] == [packed(rgb(DARK.other_car))]
    assert "/other_cars/body" not in recording.rows


def test_other_cars_that_are_rectangles_have_outlines(among_others, tmp_path):
    shaped = EpisodeTrace(replace(among_others.scene, body_size=(4.0, 1.8)), among_others.columns)
    write_recording(tmp_path / "others.rrd", shaped, "others")
    outlines = np.array(Recording(tmp_path / "others.rrd").rows["/other_cars/outline"]["LineStrips2D:strips"])
    np.testing.assert_allclose(outlines[:, :, :4].mean(axis=2), among_others.others[..., :2], rtol=1e-5)
    sides = np.linalg.norm(np.diff(outlines, axis=2), axis=3)
    np.testing.assert_allclose(sides, np.tile([1.8, 4.0], (15, 2, 2))[..., ::-1], rtol=1e-5)


def test_a_car_with_pedals_has_its_numbers_as_series_by_name_and_its_outline(pedals, tmp_path):
    write_recording(tmp_path / "pedals.rrd", pedals, "pedals")
    recording = Recording(tmp_path / "pedals.rrd")
    assert "/choice" in recording.rows
    np.testing.assert_allclose(np.array(recording.rows["/action"]["Scalars:scalars"]), pedals.controls, rtol=1e-6)
    for name, entries in {"speed": ["speed"], "angles": ["slip", "steering"]}.items():
        found = np.array(recording.rows[f"/{name}"]["Scalars:scalars"]).reshape(9, -1)
        np.testing.assert_allclose(found, np.column_stack([pedals.state(entry) for entry in entries]), rtol=1e-6)
    outline = np.array(recording.rows["/car/outline"]["LineStrips2D:strips"])[:, 0]
    sides = np.linalg.norm(np.diff(outline, axis=1), axis=2)
    np.testing.assert_allclose(sides, [[4.0, 1.8, 4.0, 1.8]] * 9, rtol=1e-5)
    np.testing.assert_allclose(outline[:, :4].mean(axis=1), pedals.poses[:, :2], rtol=1e-5)
    rays = np.array(recording.rows["/car/rays"]["LineStrips2D:strips"])[:, 0, 0]
    np.testing.assert_allclose(np.linalg.norm(rays - pedals.poses[:, :2], axis=1), MOUNT, rtol=1e-5)
    colours = [row[0] for row in recording.rows["/car/trail"]["LineStrips2D:colors"]]
    assert colours[4] == packed(rgb(DARK.speed_shades[-1]))
    assert colours[0] == packed(rgb(DARK.speed_shades[0]))


def test_steps_and_times_count_from_the_beginning_of_the_episode(recording, trace, tmp_path):
    assert recording.steps["/car/body"] == list(range(15))
    assert recording.times["/car/body"] == [100_000_000 * step for step in range(15)]
    late = rewritten(trace, tmp_path, step=trace.columns["step"] + 200)
    assert late.steps["/action_value"] == list(range(200, 214))
    assert late.times["/action_value"][0] == 20_000_000_000


def test_what_is_plotted_is_what_the_log_has(recording, trace):
    rewards = np.column_stack([trace.rewards.cumsum(), trace.rewards, trace.reward_terms])
    plotted = {
        "/action_value": (trace.columns["action_value"], ["forward", "left", "right"]),
        "/reward": (rewards, ["return so far", "reward", "collision", "proximity", "gate", "steering"]),
        "/ranges": (trace.ranges, ["90° right", "45° right", "ahead", "45° left", "90° left"]),
        "/epsilon": (trace.columns["epsilon"][:, None], ["epsilon"]),
    }
    for entity, (values, names) in plotted.items():
        np.testing.assert_allclose(recording.rows[entity]["Scalars:scalars"], values)
        assert recording.rows[entity]["SeriesLines:names"] == [names]
        assert recording.steps[entity] == list(range(len(values)))


def test_actions_are_states_that_begin_where_the_action_changes(recording):
    assert recording.steps["/action"] == [0, 2, 5, 6, 7, 8]
    names = [state for (state,) in recording.rows["/action"]["StateChange:state"]]
    assert names == ["forward", "left", "forward", "right", "left", "forward"]
    assert recording.steps["/choice"] == [0, 6, 7]
    assert recording.rows["/choice"]["StateChange:state"] == [["greedy"], ["random"], ["greedy"]]


def test_events_are_told_at_their_steps(recording):
    events = recording.rows["/events"]
    assert recording.steps["/events"] == [0, 7, 13, 13]
    assert events["TextLog:text"][1:3] == [["1 gate passed"], ["near a wall: 0.15 m ahead"]]
    assert events["TextLog:level"] == [["INFO"], ["INFO"], ["WARN"], ["ERROR"]]


def test_the_track_is_there_at_all_times(recording, trace):
    for entity, lines in {
        "/track/walls": trace.track.walls,
        "/track/gates": trace.track.gates[:-1],
        "/track/start": trace.track.gates[-1:],
    }.items():
        np.testing.assert_allclose(np.array(recording.rows[entity]["LineStrips2D:strips"])[0], lines)
        assert entity not in recording.steps


def test_the_recording_says_which_episode_it_is(recording):
    assert recording.rows["/__properties"]["RecordingInfo:name"] == [["an episode"]]
    properties = recording.rows["/__properties/episode"]
    assert {name: value for name, (value,) in properties.items()} == {
        "episode": [7],
        "car": [2],
        "track": ["square"],
        "steps": [14],
        "episode_return": [-170.0],
        "gates": [1],
        "ended": ["collision"],
        "begins_at_s": [5.0],
    }


def test_the_layout_comes_with_the_recording_and_plays_from_the_start(recording):
    layout = {name: rows[0] for chunk in recording.layout for name, rows in chunk.items() if ":" in name}
    views = [
        chunk["ViewBlueprint:display_name"][0][0] for chunk in recording.layout if "ViewBlueprint:display_name" in chunk
    ]
    assert {"Track square", "Close-up", "Events", "Action value", "Epsilon"} < set(views)
    assert len(views) == 8
    assert layout["TimePanelBlueprint:timeline"] == ["time"]
    assert layout["TimePanelBlueprint:play_state"] == [2]  # rerun.blueprint.components.PlayState.Playing


def test_the_same_episode_is_the_same_recording_to_the_viewer(recording, trace, tmp_path):
    assert rewritten(trace, tmp_path).store.recording_id == recording.store.recording_id
    other = rewritten(trace, tmp_path, epsilon=trace.columns["epsilon"] / 2)
    assert other.store.recording_id != recording.store.recording_id


def test_one_step_with_all_rays_in_the_air_is_a_recording_too(trace, tmp_path):
    first = {name: column[:1] for name, column in trace.columns.items()}
    first |= {name: np.ones_like(first[name]) for name in ("observation", "next_observation")}
    short = rewritten(trace, tmp_path, **first)
    assert short.steps["/car/rays"] == [0, 1]
    assert short.steps["/car/trail"] == [1]


def test_a_recording_that_cannot_be_written_leaves_nothing_behind(trace, tmp_path):
    (tmp_path / "taken.rrd").mkdir()
    with pytest.raises(CarrlError, match="cannot be written"):
        write_recording(tmp_path / "taken.rrd", trace, "an episode")
    assert len(list(tmp_path.iterdir())) == 1


def test_without_rerun_one_is_told_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "carrl.export.rerun")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(CarrlError, match=r"need rerun-sdk, which is not installed; pip install 'carrl\[export\]'"):
        importlib.import_module("carrl.export.rerun")


def test_no_export_needs_torch():
    check = "import sys; import carrl.export.rerun, carrl.export.foxglove; assert 'torch' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@pytest.fixture
def fake_viewer(tmp_path, monkeypatch):
    """A stand-in for the viewer that notes how it was called, and ends with the status in the file `status`."""
    script = tmp_path / "viewer"
    script.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > {tmp_path}/arguments\nexit $(cat {tmp_path}/status)\n')
    script.chmod(0o755)
    (tmp_path / "status").write_text("0")
    monkeypatch.setenv("RERUN_CLI_PATH", str(script))
    return tmp_path


def test_the_viewer_listens_on_this_computer_only(fake_viewer, path):
    open_recording(path)
    arguments = (fake_viewer / "arguments").read_text().split("\n")[:-1]
    assert arguments[0] == str(path)
    options = dict(pairwise(arguments))
    assert options["--bind"] == "127.0.0.1"
    assert options["--port"] == "auto"
    assert arguments.count("--bind") == 1


def test_a_viewer_that_fails_is_an_error_with_a_remedy(fake_viewer, path):
    (fake_viewer / "status").write_text("3")
    with pytest.raises(CarrlError, match=r"the Rerun viewer failed, status 3; open '.*' on a computer with a screen"):
        open_recording(path)


@pytest.mark.slow
def test_the_viewer_draws_track_car_and_rays_the_right_way_up(trace, path, tmp_path):
    step = 10
    picture = picture_of_map(path, step, tmp_path / "map.png")
    to_pixel = pixels_per_place(picture)

    def colours(places):
        return [median_colour(picture, to_pixel(place)) for place in places]

    middles = (trace.poses[step, None, :2] + trace.ray_ends()[step]) / 2
    assert_like(colours(middles), [RAY] * 5)
    assert_like(colours([trace.poses[step, :2]]), [CAR])
    wall_middles = trace.track.walls.mean(axis=1)
    assert_like(colours(wall_middles), [WALL] * 8)
    ways = (trace.poses[:-1, :2] + trace.poses[1:, :2]) / 2
    driven = [row for row in range(step - 1) if np.linalg.norm(middles - ways[row], axis=1).min() > 1]
    assert len(driven) >= 7
    assert_like(colours(ways[driven]), [ACTIONS[trace.actions[row]] for row in driven])
    assert_like(colours([(10, 10), (3, 3), (3, 17)]), [GROUND] * 3)


def assert_like(found, expected):
    np.testing.assert_allclose(found, expected, atol=40)


def median_colour(picture, pixel):
    """The most usual colour of what is drawn on the ground within a pixel or so, or that of the ground."""
    column, row = np.round(pixel).astype(int)
    patch = picture[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3).astype(int)
    drawn = np.abs(patch - GROUND).max(axis=1)
    return patch[drawn.argmax()]


def pixels_per_place(picture):
    """Finds the outer walls, a square of 20 m, and returns what tells the column and row of a place, m, y upwards."""
    walls = np.abs(picture.astype(int) - WALL).max(axis=2) < 12
    top, bottom = np.flatnonzero(walls.sum(axis=1) > 100)[[0, -1]]
    left, right = np.flatnonzero(walls.sum(axis=0) > 100)[[0, -1]]
    assert right - left == pytest.approx(bottom - top, abs=3)
    return lambda place: np.array([left + (right - left) * place[0] / 20, bottom - (bottom - top) * place[1] / 20])


def picture_of_map(recording, step, png):
    """The map as the viewer draws it at a step, [H, W, 3]; without a window."""
    with headless_viewer(recording) as viewer:
        viewer.set_time("step", sequence=step, play_state="paused")
        (view,) = [view for view in viewer.get_state().views if view.origin == "/map"]
        save_screenshot(viewer, png, view)
    with Image.open(png) as image:
        return np.asarray(image.convert("RGB"))
