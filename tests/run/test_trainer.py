"""The training loop, on short runs."""

import csv
import math

import pytest
import torch

from carrl.config import config_dir
from carrl.errors import CarrlError, ConfigError
from carrl.log import load
from carrl.record.writer import TransitionWriter
from carrl.run.build import build_pipeline
from carrl.run.folder import RunFolder
from carrl.run.trainer import Trainer
from tests.configs import compose


def train(folder, *overrides):
    """A finished trainer and its pipeline."""
    config = compose("env.num_envs=8", "trainer.frames=400", "evaluation.interval=1000", *overrides)
    pipeline = build_pipeline(config)
    recorder = TransitionWriter(folder / "train.mcap", attachments={}, metadata={})
    with RunFolder(folder, recorder) as run:
        trainer = Trainer(pipeline, run)
        trainer.run(lambda _: None)
    return trainer, pipeline


def parameters(pipeline):
    return torch.cat([parameter.detach().flatten() for parameter in pipeline.network.parameters()])


@pytest.mark.parametrize("num_envs", [1, 4, 8])
def test_there_is_one_update_per_env_step_once_the_buffer_holds_a_batch(tmp_path, num_envs):
    trainer, _ = train(tmp_path, f"env.num_envs={num_envs}", "replay_buffer.batch_size=32")
    # The round that fills the buffer to 32 transitions already learns, once for each of its own steps.
    assert trainer.frames == 400
    assert trainer.updates == 400 - 32 + num_envs


@pytest.mark.parametrize("num_envs", [1, 8])
def test_target_network_changes_exactly_at_env_steps_c_2c_3c(tmp_path, num_envs):
    limits = ("trainer.frames=350", "evaluation.interval=1000")
    pipeline = build_pipeline(compose(f"env.num_envs={num_envs}", "target_updater.period=100", *limits))
    seen = []
    step, updater = 0, pipeline.target_updater
    original = updater.step

    def watched_step():
        nonlocal step
        before = pipeline.loss.target_value_network_params.clone()
        original()
        step += 1
        if (pipeline.loss.target_value_network_params != before).any():
            seen.append(step)

    updater.step = watched_step
    with RunFolder(tmp_path) as folder:
        trainer = Trainer(pipeline, folder)
        trainer.run(lambda _: None)
    # At 100 steps no update has been made yet (a batch is 128), so the copy at C changes nothing there.
    assert seen == [200, 300]
    assert step == trainer.frames


def test_the_log_holds_every_transition_that_the_learner_saw(tmp_path):
    trainer, pipeline = train(tmp_path)
    log = load(tmp_path / "train.mcap")
    assert len(log) == trainer.frames == 400
    stored = pipeline.replay_buffer[:]
    for key in (("observation",), ("action",), ("next", "observation"), ("next", "reward"), ("next", "terminated")):
        assert torch.equal(log[key], stored[key])


def test_the_log_tells_episodes_apart(tmp_path):
    trainer, _ = train(tmp_path, "env.num_envs=2")
    log = load(tmp_path / "train.mcap")
    for number in log["episode"].unique().tolist():
        episode = log[log["episode"] == number]
        assert torch.equal(episode["step"], torch.arange(len(episode)))
        assert len(episode["env"].unique()) == 1
        assert not episode["next", "done"][:-1].any()
    assert int(log["next", "done"].sum()) == trainer.episodes
    with (tmp_path / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == trainer.episodes
    for row in rows:
        episode = log[log["episode"] == int(row["episode"])]
        assert float(row["episode_return"]) == episode["next", "reward"].sum().item()
        assert int(row["length"]) == len(episode)


def test_epsilon_in_the_log_is_equation_4_of_the_env_steps_before(tmp_path):
    train(tmp_path, "env.num_envs=4", "exploration.decay_rate=1e-3")
    log = load(tmp_path / "train.mcap")
    expected = torch.tensor([0.01 + 0.98 * math.exp(-1e-3 * (frame // 4 * 4)) for frame in range(400)])
    torch.testing.assert_close(log["epsilon"], expected)


def test_the_same_seed_trains_the_same_network(tmp_path):
    weights = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        torch.manual_seed(len(weights))  # what torch's own generator holds does not matter
        _, pipeline = train(tmp_path / name, "seed=3")
        weights.append(parameters(pipeline))
    assert torch.equal(*weights)
    (tmp_path / "c").mkdir()
    _, other = train(tmp_path / "c", "seed=4")
    assert not torch.equal(weights[0], parameters(other))


def test_the_run_ends_at_the_episode_limit(tmp_path):
    trainer, _ = train(tmp_path, "trainer.episodes=3", "trainer.frames=100000", "env.num_envs=1")
    assert trainer.episodes == 3
    assert trainer.frames < 1000


def test_stop_ends_the_run_after_the_round(tmp_path):
    pipeline = build_pipeline(compose("env.num_envs=4"))
    with RunFolder(tmp_path) as folder:
        trainer = Trainer(pipeline, folder)
        trainer.run(lambda running: running.stop() if running.frames >= 40 else None)
    assert trainer.frames == 40
    assert trainer.last is not None
    assert (tmp_path / "checkpoints" / "last.pt").exists()


def test_evaluations_come_at_their_interval_for_any_number_of_cars(tmp_path):
    train(tmp_path, "env.num_envs=3", "evaluation.interval=100")
    with (tmp_path / "evaluations.csv").open() as file:
        frames = [int(row["frames"]) for row in csv.DictReader(file)]
    assert frames == [102, 201, 300, 402]


def test_a_loss_that_is_not_a_number_stops_the_run(tmp_path):
    with pytest.raises(CarrlError, match="the loss is nan at frame"):
        train(tmp_path, "reward.gate=nan", "trainer.frames=3000", "env.random_start=true")


@pytest.mark.parametrize("override", ["trainer.frames=0", "trainer.episodes=-1", "evaluation.interval=0", "seed=-1"])
def test_limits_that_allow_nothing_are_refused(override):
    with pytest.raises(ConfigError, match="must be"):
        build_pipeline(compose(override))


def test_the_configuration_is_found():
    assert (config_dir() / "train.yaml").is_file()
