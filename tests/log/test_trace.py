"""One episode of a log, and the world it was driven in, as the views see them."""

import json
import math

import numpy as np
import pytest
import torch

import carrl
from carrl.data.episodes import EpisodeTracker
from carrl.errors import DamagedLogError, LogError
from carrl.log import Log, read_trace
from carrl.log.messages import Episode
from carrl.log.scene import Scene, TrackShape
from carrl.log.schema import COLUMNS
from carrl.log.trace import read_scene
from carrl.log.writer import LogWriter
from carrl.train.provenance import describe_run, scene_of


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A log of two cars, one of which turns left, goes forward, turns right and so on; its environment and steps."""
    env = carrl.TrackEnv("oval", num_envs=2, seed=0, max_steps=7)
    tracker = EpisodeTracker(1, 2, env.track.gate_count, env.simulator.vehicle.time_step)
    path = tmp_path_factory.mktemp("driven") / "train.mcap"
    attachments = {"track.json": json.dumps(env.track.as_dict()).encode(), "config.yaml": b"seed: 0\n"}
    state, steps = env.reset(), []
    with LogWriter(path, attachments=attachments, metadata=describe_run(env, seed=0, cars=2)) as writer:
        for step in range(10):
            state["action"] = torch.tensor([(1, 0, 2)[step % 3], 0])
            transition, state = env.step_and_maybe_reset(state)
            batch = transition[:, None]
            episodes = tracker.follow(batch)[0]
            batch = batch[:, 0]
            batch["action_value"], batch["epsilon"] = torch.randn(2, 3), torch.full((2,), 0.5)
            batch["exploratory"] = torch.tensor([True, False])
            writer.write(batch.select(*(column.key for column in COLUMNS)))
            for episode in episodes:
                writer.write_episode(episode)
            steps.append(batch)
    return path, env, steps


def test_the_scene_is_that_of_the_environment(driven):
    path, env, _ = driven
    with Log(path) as log:
        scene = read_scene(log)
    assert scene.action_names == ("forward", "left", "right")
    assert scene.reward_terms == ("collision", "proximity", "gate", "steering")
    assert np.array_equal(scene.sensor_angles, env.sensor_angles.double().numpy())
    assert (scene.sensor_range, scene.time_step, scene.body_radius) == (10.0, 0.1, 0.5)
    [track] = scene.tracks
    assert track.name == "oval" and track.length == env.track.length
    assert np.array_equal(track.walls.astype(np.float32), env.track.walls.numpy())
    assert np.array_equal(track.gates.astype(np.float32), env.track.gates.numpy())
    low_x, low_y, high_x, high_y = track.bounds
    assert low_x < 0 < high_x and low_y < 0 < high_y


def test_a_trace_follows_the_car_to_where_it_came_to(driven):
    path, _, steps = driven
    with Log(path) as log:
        trace = read_trace(log, 0)
    assert (len(trace), trace.episode, trace.env, trace.first_step, trace.ended) == (7, 0, 0, 0, "time limit")
    assert trace.actions.tolist() == [1, 0, 2, 1, 0, 2, 1]
    assert trace.exploratory.all()
    expected = [step["pose"][0] for step in steps[:7]] + [steps[6]["next", "pose"][0]]
    assert trace.poses == pytest.approx(torch.stack(expected).numpy(), abs=1e-5)
    assert trace.times == pytest.approx(np.arange(8) * 0.1)


def test_the_rays_of_a_trace_end_at_the_walls_or_at_the_range(driven):
    import shapely

    path, _, steps = driven
    with Log(path) as log:
        trace = read_trace(log, 0)
    assert trace.ranges.shape == (8, 7)
    assert trace.ranges[-1] == pytest.approx(steps[6]["next", "observation"][0].numpy() * 10.0)
    walls = shapely.multilinestrings(shapely.linestrings(trace.track.walls))
    gaps = shapely.distance(shapely.points(trace.ray_ends()), walls)
    assert (gaps[trace.ranges < 9.99] < 1e-3).all()
    assert (trace.ranges < 9.99).any()


def test_an_episode_cut_by_the_end_of_the_run_is_unfinished(driven):
    with Log(driven[0]) as log:
        assert read_trace(log, 2).ended == "unfinished"
        assert len(read_trace(log, 2)) == 3


def test_gates_are_counted_by_the_rewards_for_them(driven):
    with Log(driven[0]) as log:
        trace = read_trace(log, 1)
    columns = {name: values.copy() for name, values in trace.columns.items()}
    columns["reward_terms"][:] = 0
    columns["reward_terms"][[1, 4], 2] = 50.0
    counted = type(trace)(trace.scene, columns)
    assert counted.gates_passed.tolist() == [0, 0, 1, 1, 1, 2, 2, 2]


def test_an_episode_that_the_log_does_not_hold_is_refused(driven):
    with Log(driven[0]) as log, pytest.raises(LogError, match="holds no step of episode 99; carrl log ls"):
        read_trace(log, 99)


def write_log(path, transitions, **changes):
    """A log of four transitions whose scene has these entries changed; None leaves one out."""
    track = {
        "name": "t",
        "length": 4.0,
        "centreline": [[0, 0], [1, 1]],
        "walls": [[[0, 0], [1, 0]]],
        "gates": [[[0, 0], [0, 1]]],
    }
    scene = Scene(("a", "b", "c"), ("a", "b", "gate", "d"), np.zeros(7), 10.0, 0.1, 0.5, np.zeros((3, 3)), ())
    entries = {**scene.entries(), **{key: value for key, value in changes.items() if key != "track"}}
    attachments = {"track.json": changes.get("track", json.dumps(track).encode())}
    with LogWriter(
        path, attachments=attachments, metadata={key: value for key, value in entries.items() if value is not None}
    ) as writer:
        batch = transitions(4)
        batch["track"] = torch.zeros(4, dtype=torch.int64)
        writer.write(batch)
        writer.write_episode(Episode(0, 0, 0, 0, 0, 10**9, 0.0, 4, 0, 0, "collision", (0.0, 0.0, 0.0)))
    return path


def test_a_log_that_tells_everything_gives_a_trace(tmp_path, transitions):
    with Log(write_log(tmp_path / "a.mcap", transitions)) as log:
        assert len(read_trace(log, 0)) == 4


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"action_names": None}, "no entry 'action_names'"),
        ({"action_names": '["a"]'}, "'manoeuvres' has the shape"),
        ({"sensor_angles_rad": "{"}, "'sensor_angles_rad' is not JSON"),
        ({"sensor_angles_rad": "[[1], [1, 2]]"}, "'sensor_angles_rad' is no list of numbers"),
        ({"sensor_angles_rad": json.dumps([0.0] * 8)}, "it has 7 readings for 8 rays"),
        ({"sensor_angles_rad": "[]"}, "it has 7 readings for 0 rays"),
        ({"reward_terms": '["gate"]'}, "column 'reward_terms' is 4 wide for 1 names"),
        ({"action_names": '["a"]', "manoeuvres": "[[1, 0, 0]]"}, "column 'action_value' is 3 wide for 1 names"),
        ({"sensor_range_m": "-1"}, "'sensor_range_m' is -1.0; it must be positive"),
        ({"time_step_s": "NaN"}, "'time_step_s' is nan"),
        ({"body_radius_m": '"wide"'}, "'body_radius_m' is 'wide'"),
        ({"manoeuvres": json.dumps([[math.inf] * 3] * 3)}, "'manoeuvres' has the shape [3, 3], or a value"),
        ({"track": b"[]"}, "the attachment does not describe a track"),
        ({"track": b"{" * 100_000}, "the attachment does not describe a track"),
        (
            {"track": b'{"name": "t", "length": 1, "centreline": [], "walls": [], "gates": []}'},
            "does not describe a track",
        ),
    ],
)
def test_a_log_that_does_not_tell_what_was_driven_is_refused_in_one_sentence(tmp_path, transitions, changes, words):
    with Log(write_log(tmp_path / "a.mcap", transitions, **changes)) as log, pytest.raises(DamagedLogError) as caught:
        read_trace(log, 0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_entries_of_a_scene_come_back(driven):
    scene = scene_of(driven[1])
    again = Scene.from_entries(scene.entries(), [])
    assert again.entries() == scene.entries()


def test_a_track_shape_needs_finite_numbers():
    with pytest.raises(ValueError, match="does not describe a track"):
        TrackShape.from_json(
            b'{"name": "t", "length": NaN, "centreline": [[0, 0]], '
            b'"walls": [[[0, 0], [1, 0]]], "gates": [[[0, 0], [0, 1]]]}'
        )
