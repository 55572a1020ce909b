"""One episode of a log, and the world it was driven in, as the views see them."""

import dataclasses
import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pytest
import torch

import carrl
from carrl.cli.main import main
from carrl.data.description import describe_run, log_schema, scene_of
from carrl.data.source import EpisodeTracker
from carrl.errors import DamagedLogError, LogError
from carrl.log import Column, Log, read_trace
from carrl.log.messages import Episode
from carrl.log.scene import ObservationPart, Scene, TrackShape
from carrl.log.trace import read_scene, with_choices
from carrl.log.writer import LogWriter
from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import ContinuousActions
from carrl.task.episode import Start
from carrl.task.reward import Collision, Gate, Reward
from tests.driven_episode import SPEED
from tests.logs import dqn_columns, make_schema

ROUNDS = 60


def drive(path, env, schema, rounds, choose, first=0):
    """Writes a log of an environment whose cars `choose` drives, from a round on; returns every round's transitions."""
    gates = [track.gate_count for track in env.tracks]
    tracker = EpisodeTracker(1, env.batch_size[0], gates, env.simulator.vehicle.time_step)
    names = [f"track-{index}.json" if index else "track.json" for index in range(len(env.tracks))]
    attachments = {name: json.dumps(track.as_dict()).encode() for name, track in zip(names, env.tracks, strict=True)}
    attachments["config.yaml"] = b"seed: 0\n"
    state, steps = env.reset(), []
    with LogWriter(path, schema=schema, attachments=attachments, metadata=describe_run(env.task, 0, 2)) as writer:
        for number in range(rounds):
            transition, state = env.step_and_maybe_reset(choose(number, state))
            batch = transition[:, None]
            episodes = tracker.follow(batch)[0]
            batch = batch[:, 0]
            batch["action_value"], batch["epsilon"] = torch.randn(len(batch), 3), torch.full((len(batch),), 0.5)
            batch["exploratory"] = torch.arange(len(batch)) == 0
            batch["log_prob"] = torch.full((len(batch),), -1.5, dtype=torch.float64)
            if number >= first:
                writer.write(batch.select(*schema.keys))
            for episode in episodes:
                writer.write_episode(episode)
            steps.append(batch)
    return steps


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A log of two cars, one of which turns left, goes forward, turns right and so on; its environment and steps."""
    env = carrl.TrackEnv("oval", num_envs=2, seed=0, max_steps=7)
    path = tmp_path_factory.mktemp("driven") / "train.mcap"

    def choose(number, state):
        return state.set("action", torch.tensor([(1, 0, 2)[number % 3], 0]))

    return path, env, drive(path, env, log_schema(env.task, dqn_columns()), 10, choose)


EPISODE = {".csv": [], ".npz": [], ".html": ["--episode", "0"], ".gif": ["--episode", "0"]}
"""Flags of an export to a file with this ending."""


def assert_true(trace, steps):
    """Every state, gate and count of the trace is that of the simulation."""
    car, key = trace.car, "state" if "state" in steps[0] else "pose"
    own = [step[car] for step in steps if int(step[car]["episode"]) == trace.episode]
    own = own[len(own) - len(trace) :]
    last = own[-1]["next"]
    assert np.array_equal(trace.states, torch.stack([*(step[key] for step in own), last[key]]).double().numpy())
    assert np.array_equal(trace.poses, torch.stack([*(step["pose"] for step in own), last["pose"]]).double().numpy())
    counts = [*(int(step["gates_passed"]) for step in own), int(last["gates_passed"])]
    assert trace.gates_passed.tolist() == counts
    gates = len(trace.track.gates)
    expected = [
        (row, (int(step["next_gate"]) + nth) % gates)
        for row, step in enumerate(own)
        for nth in range(counts[row + 1] - counts[row])
    ]
    assert trace.passings == expected
    assert all(int(own[row]["next", "next_gate"]) == (gate + 1) % gates for row, gate in dict(expected).items())
    return len(expected)


@pytest.mark.parametrize("weight", [50.0, 0.0])
@pytest.mark.parametrize("first", [0, 25], ids=["from the begin", "the begin is missing"])
def test_a_trace_is_what_was_simulated_whatever_is_driven_and_paid(tmp_path, weight, first):
    reward = Reward({"collision": Collision(), "gate": Gate(weight)})
    env = carrl.TrackEnv(["paper", "oval"], num_envs=6, seed=3, max_steps=40, reward=reward, start=Start(anywhere=True))
    steps = drive(
        tmp_path / "a.mcap",
        env,
        log_schema(env.task, dqn_columns()),
        120,
        lambda _, state: env.rand_action(state) if torch.rand(()) < 0.3 else state.set("action", rule(state)),
        first,
    )
    with Log(tmp_path / "a.mcap") as log:
        episodes = np.unique(log.columns()["episode"]).tolist()
        passed = [assert_true(read_trace(log, episode), steps) for episode in episodes]
    assert sum(passed) > 10
    assert len(episodes) > 15


def rule(state):
    """To the side whose rays are longer."""
    left, right = state["observation"][:, 4:].sum(-1), state["observation"][:, :3].sum(-1)
    return torch.where((left - right).abs() < 0.5, 0, torch.where(left > right, 1, 2))


@dataclass(frozen=True)
class Drifting(VehicleModel):
    """A vehicle whose state and controls are more than a pose and a steering wheel."""

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "heading", "speed", "slip", "yaw_rate")
    control_names: ClassVar[tuple[str, ...]] = ("steer", "throttle")
    time_step: float = 0.1
    body_radius: float = 0.5

    @property
    def step_length(self):
        return 0.5

    def step(self, state, control):
        x, y, heading, speed, slip, _ = state.unbind(-1)
        steer, throttle = control.unbind(-1)
        speed = (speed + throttle).clamp(0, 4)
        x, y = x + 0.1 * speed * heading.cos(), y + 0.1 * speed * heading.sin()
        return torch.stack([x, y, heading + 0.1 * steer, speed, 0.5 * slip + 0.1 * steer, steer], dim=-1)


def test_a_log_of_another_vehicle_other_actions_and_another_algorithm_reads_by_what_it_says_itself(tmp_path, capsys):
    action = ContinuousActions(("steer", "throttle"))
    env = carrl.TrackEnv("oval", num_envs=2, seed=0, max_steps=30, vehicle=Drifting(), action=action)
    schema = log_schema(env.task, [Column("log_prob", "log_prob", "float64", (), "log probability of the action")])
    path = tmp_path / "train.mcap"
    steps = drive(path, env, schema, ROUNDS, lambda _, state: env.rand_action(state))
    with Log(path) as log:
        assert log.schema == schema
        for episode in (0, 1):
            assert_true(read_trace(log, episode), steps)
    loaded = carrl.log.load(path)
    for key in schema.keys:
        assert torch.equal(loaded[key], torch.cat([step[key] for step in steps]))
    assert torch.equal(loaded["next", "pose"], loaded["next", "state"][:, :3])
    for verb in (["info"], ["ls"], ["show"], ["stats"], ["cat", "--limit", "2"], ["check"]):
        for flags in ([], ["--json"]):
            assert main(["log", verb[0], str(path), *verb[1:], *flags]) == 0
    assert "log_prob -1.5" in capsys.readouterr().out
    for ending in (".csv", ".npz", ".html"):
        assert main(["log", "export", str(path), str(tmp_path / f"out{ending}")]) == 0
    heading = (tmp_path / "out.csv").read_text().splitlines()[0].split(",")
    assert {"action_steer", "action_throttle", "state_slip", "next_state_yaw_rate", "log_prob"} <= set(heading)


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
    assert (len(trace), trace.episode, trace.car, trace.first_step, trace.ended) == (7, 0, 0, 0, "time limit")
    assert trace.actions.tolist() == [1, 0, 2, 1, 0, 2, 1]
    assert trace.exploratory.all()
    assert_true(trace, steps)
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
    parts = (ObservationPart("rays", 7, 0.0, 1.0),)
    scene = Scene(("a", "b", "c"), ("steer",), parts, ("a", "b", "gate", "d"), np.zeros(7), 10.0, 0.1, 0.5, ())
    entries = {**scene.entries(), **{key: value for key, value in changes.items() if key not in ("track", "gates")}}
    attachments = {"track.json": changes.get("track", json.dumps(track).encode())}
    with LogWriter(
        path,
        schema=make_schema(),
        attachments=attachments,
        metadata={key: value for key, value in entries.items() if value is not None},
    ) as writer:
        batch = transitions(4)
        batch["track"] = batch["next_gate"] = torch.zeros(4, dtype=torch.int64)
        batch["next", "gates_passed"] = batch["gates_passed"] + changes.get("gates", 0)
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
        ({"sensor_angles_rad": "{"}, "'sensor_angles_rad' is not JSON"),
        ({"sensor_angles_rad": "[[1], [1, 2]]"}, "'sensor_angles_rad' is no list of numbers"),
        ({"sensor_angles_rad": json.dumps([0.0] * 8)}, "it has no reading for each of 8 rays among 7 of rays"),
        ({"sensor_angles_rad": "[]"}, "it has no reading for each of 0 rays among 7 of rays"),
        ({"reward_terms": '["gate"]'}, "column 'reward_terms' is 4 wide for 1 names"),
        ({"action_names": '["a"]'}, "column 'action_value' is 3 wide for 1 names"),
        ({"observation": '[["rays", 7]]'}, "'observation' does not describe one"),
        ({"observation": '[["rays", -7, 0, 1]]'}, "'observation' has a negative width"),
        ({"observation": '[["far", 4, 0, 1], ["rays", 7, 0, 1]]'}, "it has 7 readings for 7 rays"),
        ({"gates": 2}, "episode 0 passed gates that its track does not have"),
        ({"gates": -1}, "episode 0 passed gates that its track does not have"),
        ({"body_size_m": "[4]"}, "'body_size_m' is [4.0]; it must be a length and a width"),
        ({"body_size_m": "[4, 0]"}, "it must be a length and a width"),
        ({"sensor_mount_m": '"front"'}, "'sensor_mount_m' is 'front'"),
        ({"friction": "0"}, "'friction' is 0.0; it must be positive"),
        ({"sensor_range_m": "-1"}, "'sensor_range_m' is -1.0; it must be positive"),
        ({"time_step_s": "NaN"}, "'time_step_s' is nan"),
        ({"body_radius_m": '"wide"'}, "'body_radius_m' is 'wide'"),
        ({"sensor_angles_rad": json.dumps([[math.inf] * 7])}, "'sensor_angles_rad' has the shape [1, 7], or a value"),
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
    scene = scene_of(driven[1].task)
    again = Scene.from_entries(scene.entries(), [])
    assert again.entries() == scene.entries()


def test_a_track_shape_needs_finite_numbers():
    with pytest.raises(ValueError, match="does not describe a track"):
        TrackShape.from_json(
            b'{"name": "t", "length": NaN, "centreline": [[0, 0]], '
            b'"walls": [[[0, 0], [1, 0]]], "gates": [[[0, 0], [0, 1]]]}'
        )


def test_what_a_scene_says_of_a_car_with_pedals_comes_back(pedals):
    assert Scene.from_entries(pedals.scene.entries(), ()).entries() == pedals.scene.entries()
    back = Scene.from_entries(pedals.scene.entries(), ())
    assert (back.body_size, back.sensor_mount, back.friction) == ((4.0, 1.8), 1.5, 1.2)
    disc = dataclasses.replace(pedals.scene, body_size=None, sensor_mount=0.0, friction=None)
    assert not {"body_size_m", "sensor_mount_m", "friction"} & disc.entries().keys()


def test_the_newest_of_several_scans_is_what_the_rays_read_and_without_any_there_are_none():
    angles = np.zeros(3)
    scene = Scene(
        (),
        ("steer",),
        (ObservationPart("speed", 1, -9, 9), ObservationPart("scans", 6, 0, 1)),
        (),
        angles,
        10.0,
        0.1,
        0.5,
        (),
    )
    assert scene.rays == slice(1, 4)
    other = dataclasses.replace(scene, observation=(ObservationPart("speed", 1, -9, 9),))
    assert len(with_choices(other).sensor_angles) == 0
    with pytest.raises(ValueError, match="it has no reading for each of 3 rays among 7 of scans"):
        _ = dataclasses.replace(scene, observation=(ObservationPart("scans", 7, 0, 1),)).rays


def test_values_of_the_state_have_their_names(pedals):
    assert pedals.speeds.tolist() == SPEED.tolist()
    assert pedals.state("steering")[5] == pytest.approx(0.4)
    assert pedals.state("wings") is None
    steady = dataclasses.replace(
        pedals,
        columns={
            **pedals.columns,
            **{name: np.where(np.arange(9) == 3, 5.0, pedals.columns[name]) for name in ("state", "next_state")},
        },
    )
    assert steady.speeds is None and steady.state("speed").tolist() == [5.0] * 9
    np.testing.assert_allclose(np.linalg.norm(pedals.origins - pedals.poses[:, :2], axis=1), 1.5)
    np.testing.assert_allclose(
        pedals.ray_ends()[:, 0] - pedals.origins,
        pedals.ranges[:, :1]
        * np.column_stack([np.cos(pedals.poses[:, 2] - np.pi / 2), np.sin(pedals.poses[:, 2] - np.pi / 2)]),
        atol=1e-12,
    )


def test_a_log_of_a_car_with_pedals_is_read_by_every_verb_and_written_in_every_format(tmp_path, capsys):
    action = ContinuousActions(("steer", "pedal"))
    sensor = Sensor(rays=7, max_range=30.0, mount=1.2)
    env = carrl.TrackEnv("oval", num_envs=2, seed=0, max_steps=30, vehicle=Kinematic(), sensor=sensor, action=action)
    schema = log_schema(env.task, [Column("log_prob", "log_prob", "float64", (), "log probability of the action")])
    path = tmp_path / "train.mcap"
    steps = drive(path, env, schema, ROUNDS, lambda _, state: env.rand_action(state))
    with Log(path) as log:
        trace = read_trace(log, 0)
    assert_true(trace, steps)
    scene = trace.scene
    assert (scene.body_size, scene.sensor_mount, scene.friction) == ((4.508, 1.61), 1.2, 1.0489)
    first = [step[0]["action"] for step in steps[: len(trace)]]
    np.testing.assert_array_equal(trace.controls, torch.stack(first).double().numpy())
    for verb in (["info"], ["ls"], ["show"], ["stats"], ["cat", "--limit", "2"], ["check"]):
        for flags in ([], ["--json"]):
            capsys.readouterr()
            assert main(["log", verb[0], str(path), *verb[1:], *flags]) == 0
            out = capsys.readouterr().out
            if verb == ["stats"] and flags:
                counts = json.loads(out)["controls"]
                every = torch.cat([step["action"] for step in steps]).numpy()
                edges = np.linspace(-1, 1, 9)
                for index, name in enumerate(("steer", "pedal")):
                    expected = [int(((a <= every[:, index]) & (every[:, index] < b)).sum()) for a, b in pairwise(edges)]
                    assert counts[name]["counts"] == expected
    assert main(["log", "stats", str(path), "--png", str(tmp_path / "stats.png")]) == 0
    for ending in (".csv", ".npz", ".html", ".gif"):
        assert main(["log", "export", str(path), str(tmp_path / f"out{ending}"), *EPISODE[ending]]) == 0
    heading, row = (tmp_path / "out.csv").read_text().splitlines()[:2]
    values = dict(zip(heading.split(","), row.split(","), strict=True))
    assert np.float32(values["action_pedal"]) == first[0][1].item()
    assert {"state_speed", "next_state_lateral_acceleration", "log_prob"} <= values.keys()


def test_a_trace_that_ended_at_no_wall_is_no_collision(trace):
    ended = np.zeros((len(trace), 1), dtype=bool)
    ended[-1] = True
    columns = {**trace.columns, "terminated": ended, "truncated": ~ended & False}
    assert dataclasses.replace(trace, columns=columns).ended == "collision"
    assert dataclasses.replace(trace, columns={**columns, "collided": ended}).ended == "collision"
    assert dataclasses.replace(trace, columns={**columns, "collided": ~ended & False}).ended == "other end"
