"""What an evaluation drove, kept as a log in the format of training's."""

import json

import numpy as np
import pytest
import torch

from carrl import Track
from carrl.errors import CarrlError
from carrl.evaluation.baselines import rule_policy
from carrl.evaluation.drive_log import DriveLog
from carrl.evaluation.rollout import TrackEvaluator
from carrl.log import read_columns, read_episodes
from carrl.log.codec import Selection
from carrl.log.laps import recorded_laps
from carrl.log.reader import Log
from carrl.log.trace import read_trace
from carrl.log.verification import verify
from carrl.opponents.line import LineOpponents
from carrl.train.run import Run
from tests.export.untrained_runs import write_untrained_run
from tests.worlds import make_world

TRACKS = ("oval", "serpentine")


def straight_on(observation):
    return torch.zeros(len(observation), dtype=torch.int64)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """The rule on two tracks from two places each, in groups of one track, and the log of it."""
    path = tmp_path_factory.mktemp("drives") / "drive.mcap"
    world, tracks = make_world(), [Track.load(name) for name in TRACKS]
    evaluator = TrackEvaluator(world, tracks, starts=2)
    evaluator._simulators = [world.simulator(track) for track in tracks]
    with DriveLog(path, "seed: 7\n", tracks, drives=4, seed=7, entries={"policy": "rule"}) as log:
        laps = evaluator.evaluate(rule_policy, traced=True, recorder=log)
    return path, [drive for of_track in laps for drive in of_track]


def test_the_log_is_intact_and_says_what_drove(driven):
    path, _ = driven
    found = verify(path)
    assert (found.episodes, found.metrics) == (4, 0)
    assert found.transitions == sum(episode.length for episode in read_episodes(path))
    with Log(path) as log:
        assert (log.metadata["policy"], log.metadata["seed"], log.metadata["track"]) == ("rule", "7", "2 tracks")
        assert log.attachment("config.yaml") == b"seed: 7\n"
        assert json.loads(log.attachment("track-1.json"))["name"] == "serpentine"


def test_each_drive_is_an_episode_on_its_track_with_the_figures_of_the_evaluation(driven):
    path, drives = driven
    for number, (episode, drive) in enumerate(zip(read_episodes(path), drives, strict=True)):
        assert (episode.episode, episode.env, episode.track) == (number, number, number // 2)
        assert (episode.laps, episode.ended) == (1, "time limit")
        assert episode.episode_return == pytest.approx(drive.lap_reward)
        with Log(path) as log:
            trace = read_trace(log, number)
        np.testing.assert_array_equal(trace.poses[: drive.lap_steps + 1], drive.poses)
        np.testing.assert_array_equal(trace.actions[: drive.lap_steps], drive.actions)
        np.testing.assert_allclose(trace.ranges[: drive.lap_steps + 1], np.minimum(drive.ranges, 10.0), atol=1e-5)
        assert trace.ended == "laps complete"


def test_a_lap_is_complete_wherever_it_began_between_two_gates(tmp_path):
    """Its last gate is not passed in the last step: the car drives on to the line where it began."""
    track, path = Track.load("oval"), tmp_path / "drive.mcap"
    with DriveLog(path, "seed: 7\n", [track], drives=5, seed=7, entries={"policy": "rule"}) as log:
        TrackEvaluator(make_world(), [track], starts=5).evaluate(rule_policy, recorder=log)
    with Log(path) as log:
        traces = [read_trace(log, number) for number in range(5)]
    assert any(trace.gates_passed[-1] == trace.gates_passed[-2] for trace in traces)
    assert {trace.ended for trace in traces} == {"laps complete"}


def test_the_laps_of_the_log_are_those_of_the_evaluation(driven):
    path, drives = driven
    with Log(path) as log:
        for number in (0, 2):  # from the start line
            (lap,) = recorded_laps(read_trace(log, number))
            assert lap.seconds == pytest.approx(drives[number].lap_time, abs=1e-6)


def test_the_second_group_of_tracks_begins_when_the_first_has_ended(driven):
    path, _ = driven
    first, _, third, _ = read_episodes(path)
    assert first.begin_ns == 0
    assert third.begin_ns >= first.end_ns > 0
    times = read_columns(path)["time_ns"]
    assert (np.diff(times) >= 0).all()


def test_a_drive_into_a_wall_terminates_and_the_other_goes_on(tmp_path):
    world = make_world("oval")
    tracks = [world.track]
    with DriveLog(tmp_path / "drive.mcap", "", tracks, drives=2, seed=0, entries={}) as log:
        drives = TrackEvaluator(world, tracks, starts=2).evaluate(straight_on, recorder=log)[0]
    episodes = list(read_episodes(tmp_path / "drive.mcap"))
    assert [episode.ended for episode in episodes] == ["collision", "collision"]
    assert sorted(episode.length for episode in episodes) == sorted(drive.lap_steps for drive in drives)
    columns = read_columns(tmp_path / "drive.mcap", Selection(episodes=[0]))
    assert columns["terminated"][:, 0].tolist() == [False] * (len(columns["step"]) - 1) + [True]
    assert not columns["truncated"].any()


def test_a_network_tells_the_values_that_it_chose_by(tmp_path):
    run = Run.load(write_untrained_run(tmp_path / "run"))
    run.evaluate(["oval"], log=tmp_path / "drive.mcap")
    columns = read_columns(tmp_path / "drive.mcap")
    np.testing.assert_array_equal(columns["action_value"].argmax(axis=1), columns["action"])
    np.testing.assert_array_equal(run.policy(columns["observation"]), columns["action"])
    with Log(tmp_path / "drive.mcap") as log:
        assert (log.metadata["policy"], log.metadata["checkpoint"]) == ("greedy", "best")
        assert "epsilon" not in log.schema.by_name


def test_numbers_as_actions_are_kept_as_they_were_driven(tmp_path):
    run = Run.load(write_untrained_run(tmp_path / "run", "loss=sac", "vehicle=kinematic"))
    run.evaluate(["oval"], log=tmp_path / "drive.mcap")
    columns = read_columns(tmp_path / "drive.mcap")
    assert columns["action"].shape[1] == len(run.world.action.control_names)
    np.testing.assert_allclose(run.policy(columns["observation"]), columns["action"], atol=1e-6)


def test_a_log_of_two_seeds_or_over_a_file_is_refused_before_anything_is_driven(tmp_path):
    for seed in (0, 1):
        write_untrained_run(tmp_path / "run" / f"seed={seed}", seed=seed)
    both, one = Run.load(tmp_path / "run"), Run.load(tmp_path / "run" / "seed=0")
    with pytest.raises(CarrlError, match="one policy can be watched and kept at a time, and here are 2"):
        both.evaluate(log=tmp_path / "drive.mcap")
    (tmp_path / "train.mcap").write_text("precious")
    with pytest.raises(CarrlError, match="no log is written over another file"):
        one.evaluate(log=tmp_path / "train.mcap")
    with pytest.raises(CarrlError, match=r"it must end in \.mcap"):
        one.evaluate(log=tmp_path / "drive.csv")
    assert (tmp_path / "train.mcap").read_text() == "precious"
    assert not (tmp_path / "drive.mcap").exists()


@pytest.mark.parametrize(
    "own",
    [{"bump": 0.9}, {"opponents": LineOpponents(), "cars_per_world": 3}],
    ids=["several ends", "opponents"],
)
def test_logs_of_drives_say_what_ended_them(own, tmp_path):
    world, track = make_world("oval", **own), Track.load("oval")
    with DriveLog(tmp_path / "drive.mcap", "seed: 7\n", [track], drives=1, seed=7, entries={}) as log:
        TrackEvaluator(world, [track], starts=1).evaluate(straight_on, recorder=log)
    columns = read_columns(tmp_path / "drive.mcap")
    assert columns["collided"].ravel().tolist() == columns["terminated"].ravel().tolist()
    assert columns["collided"].ravel()[-1]
    assert ("other_poses" in columns) == ("opponents" in own)
