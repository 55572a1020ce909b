"""Logs and pictures of cars among opponents."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import carrl.log
from carrl.cli.main import main
from carrl.env.gym_env import GymTrackEnv
from carrl.export.page import replay_page
from carrl.log.reader import Log
from carrl.log.trace import _check_columns, read_trace
from carrl.opponents.line import LineOpponents
from carrl.render.colours import DARK, LIGHT, rgb
from carrl.render.trace_picture import write_picture
from carrl.render.video import motion_of
from carrl.task.episode import Start
from carrl.train.run import train

CARS = 3
SHORT = ["trainer.frames=2000", "evaluation.interval=100000"]


@pytest.fixture(scope="module")
def log_path(tmp_path_factory):
    """Of a short run among two opponents."""
    folder = tmp_path_factory.mktemp("traffic") / "run"
    train(overrides=["opponents=line", f"env.cars_per_world={CARS}", *SHORT], folder=folder)
    return folder / "train.mcap"


@pytest.fixture(scope="module")
def trace(log_path):
    """Of its longest episode."""
    with Log(log_path) as log:
        longest = max(log.episodes(), key=lambda episode: episode.length)
        return read_trace(log, longest.episode)


def test_a_log_has_the_opponents_poses_before_and_after_each_step(log_path, trace):
    columns = carrl.log.read_columns(log_path)
    assert columns["other_poses"].shape == (len(columns["action"]), 3 * (CARS - 1))
    assert trace.others.shape == (len(trace) + 1, CARS - 1, 3)
    np.testing.assert_array_equal(trace.columns["next_other_poses"][:-1], trace.columns["other_poses"][1:])
    moved = np.linalg.norm(np.diff(trace.others[..., :2], axis=0), axis=-1)
    assert (moved <= 0.9 * 1.001).all()  # the fastest of them drives at 0.8 + 0.1 of 10 m/s, in steps of 0.1 s
    assert moved[len(moved) // 2 :].min() > 0


def test_a_log_says_how_many_cars_share_a_world(log_path):
    with Log(log_path) as log:
        assert (log.metadata["cars_per_world"], log.metadata["rows_per_world"]) == (str(CARS), "1")


def test_a_log_of_a_car_alone_says_nothing_of_others(tmp_path):
    train(overrides=SHORT, folder=tmp_path / "run")
    with Log(tmp_path / "run" / "train.mcap") as log:
        assert "cars_per_world" not in log.metadata
        assert "other_poses" not in log.schema.by_name
        assert read_trace(log, 0).others.shape[1] == 0


def test_touching_a_car_is_no_collision_with_a_wall(log_path):
    with Log(log_path) as log:
        ends = {episode.ended for episode in log.episodes()}
    assert {"collision", "other end"} <= ends


def test_a_recovered_log_has_them_too(log_path, tmp_path, capsys):
    damaged, recovered = tmp_path / "damaged.mcap", tmp_path / "recovered.mcap"
    damaged.write_bytes(log_path.read_bytes()[:-2000])
    assert main(["log", "check", str(log_path)]) == 0
    assert main(["log", "recover", str(damaged), str(recovered)]) == 0
    found, whole = (carrl.log.read_columns(path)["other_poses"] for path in (recovered, log_path))
    np.testing.assert_array_equal(found, whole[: len(found)])
    assert len(found)


@pytest.mark.parametrize("name", ["other_poses", "next_other_poses"])
def test_a_pose_of_another_car_that_is_no_number_is_refused(trace, name):
    wrong = trace.columns[name].copy()
    wrong[3, 1] = np.nan
    with pytest.raises(ValueError, match="another car"):
        _check_columns(trace.scene, {**trace.columns, name: wrong})
    with pytest.raises(ValueError, match="no poses of the same cars"):
        _check_columns(trace.scene, {**trace.columns, name: wrong[:, :-1]})


def test_a_video_moves_the_others_between_steps_as_it_moves_the_car(trace):
    motion = motion_of(trace, rate=1 / trace.scene.time_step)
    np.testing.assert_allclose(motion.others[:-1], trace.others[:-1][: len(motion) - 1], atol=1e-5)
    assert motion_of(trace, rate=40).others.shape[1:] == (CARS - 1, 3)


def test_the_page_has_them_car_by_car(trace):
    alone = replace(trace, columns={key: each for key, each in trace.columns.items() if "other_poses" not in key})
    assert len(replay_page(trace, "title")) > len(replay_page(alone, "title"))


def test_the_picture_of_a_log_shows_them_in_another_colour(trace, tmp_path):
    alone = replace(trace, columns={key: each for key, each in trace.columns.items() if "other_poses" not in key})

    def pixels(episode):
        write_picture(tmp_path / "drive.png", episode, "a drive")
        with Image.open(tmp_path / "drive.png") as image:
            return int((np.asarray(image.convert("RGB")) == rgb(LIGHT.other_car)).all(axis=-1).sum())

    assert pixels(trace) > 0 == pixels(alone)


def test_the_picture_of_an_environment_shows_the_others_in_another_colour():
    colour = np.array(rgb(DARK.other_car))

    def has_it(**parts):
        env = GymTrackEnv("paper", render_mode="rgb_array", start=Start(order="last"), **parts)
        env.reset(seed=0)
        return bool((env.render() == colour).all(axis=-1).any())

    assert has_it(cars_per_world=CARS, opponents=LineOpponents())
    assert not has_it()
