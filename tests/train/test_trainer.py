"""The training loop, on short runs."""

import csv
import math
from contextlib import ExitStack

import pytest
import torch

from carrl.config import config_dir
from carrl.data.description import log_schema
from carrl.errors import CarrlError, ConfigError
from carrl.evaluation.rollout import TrackEvaluator
from carrl.log import load
from carrl.log.writer import LogWriter
from carrl.train.build import build_pipeline
from carrl.train.folder import RunFolder
from carrl.train.plan import TrainingPlan
from carrl.train.trainer import Trainer
from tests.configs import compose
from tests.train.rounds import AfterRounds

FEW_UPDATES = "trainer.frames_per_update=8"
"""Where nothing depends on them: they take most of a run's time."""


def train(folder, *overrides):
    """A finished trainer and its pipeline; with several seeds their folders are named after them."""
    config = compose("env.num_envs=8", "trainer.frames=400", "evaluation.interval=1000", *overrides)
    pipeline = build_pipeline(config)
    with ExitStack() as stack:
        folders = []
        schema = log_schema(pipeline.source.env.task, pipeline.algorithm.log_columns)
        for replicate in pipeline.algorithm.replicates:
            path = folder / str(replicate.seed) if len(pipeline.algorithm.replicates) > 1 else folder
            path.mkdir(parents=True, exist_ok=True)
            recorder = LogWriter(path / "train.mcap", schema=schema, attachments={}, metadata={})
            folders.append(stack.enter_context(RunFolder(path, recorder)))
        trainer = Trainer(pipeline, folders)
        trainer.run()
    return trainer, pipeline


def read_rows(path):
    """A table without its times."""
    with path.open() as file:
        return [{key: value for key, value in row.items() if key != "wall_time_s"} for row in csv.DictReader(file)]


def parameters(pipeline, replicate=0):
    network = pipeline.algorithm.networks[replicate]
    return torch.cat([parameter.detach().flatten() for parameter in network.parameters()])


@pytest.mark.parametrize("num_envs", [1, 4, 8])
def test_there_is_one_update_per_env_step_once_the_buffer_holds_a_batch(tmp_path, num_envs):
    trainer, pipeline = train(tmp_path, f"env.num_envs={num_envs}", "replay_buffer.batch_size=32")
    # The round that fills the buffer to 32 transitions already learns, once for each of its own steps.
    assert trainer.frames == 400
    assert pipeline.learner.updates == 400 - 32 + num_envs


@pytest.mark.parametrize("num_envs", [1, 8])
def test_target_network_changes_exactly_at_env_steps_c_2c_3c(tmp_path, num_envs):
    limits = ("trainer.frames=350", "evaluation.interval=1000")
    pipeline = build_pipeline(compose(f"env.num_envs={num_envs}", "target_updater.period=100", *limits))
    replicate = pipeline.algorithm.replicates[0]
    steps, copies = [], []
    original = replicate.target_updater.step

    def watched_step(count):
        before = replicate.loss.target_value_network_params.clone()
        original(count)
        steps.append(count)
        if (replicate.loss.target_value_network_params != before).any():
            copies.append(sum(steps))

    replicate.target_updater.step = watched_step
    with RunFolder(tmp_path) as folder:
        trainer = Trainer(pipeline, [folder])
        trainer.run()
    # At 100 steps no update has been made yet (a batch is 128), so the copy at C changes nothing there.
    assert copies == [200, 300]
    assert sum(steps) == trainer.frames


def test_the_log_holds_every_transition_that_the_learner_saw(tmp_path):
    trainer, pipeline = train(tmp_path, FEW_UPDATES)
    log = load(tmp_path / "train.mcap")
    assert len(log) == trainer.frames == 400
    stored = pipeline.replay_buffer[:][:, 0]
    for key in (("observation",), ("action",), ("next", "observation"), ("next", "reward"), ("next", "terminated")):
        assert torch.equal(log[key], stored[key])


def test_the_log_tells_episodes_apart(tmp_path):
    trainer, _ = train(tmp_path, "env.num_envs=2", FEW_UPDATES)
    log = load(tmp_path / "train.mcap")
    for number in log["episode"].unique().tolist():
        episode = log[log["episode"] == number]
        assert torch.equal(episode["step"], torch.arange(len(episode)))
        assert len(episode["car"].unique()) == 1
        assert not episode["next", "done"][:-1].any()
    assert int(log["next", "done"].sum()) == trainer.runs[0].episodes
    with (tmp_path / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == trainer.runs[0].episodes
    for row in rows:
        episode = log[log["episode"] == int(row["episode"])]
        assert float(row["episode_return"]) == episode["next", "reward"].sum().item()
        assert int(row["length"]) == len(episode)


def test_epsilon_in_the_log_is_equation_4_of_the_env_steps_before(tmp_path):
    train(tmp_path, "env.num_envs=4", "exploration.decay_rate=1e-3", FEW_UPDATES)
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


@pytest.mark.parametrize("random_start", ["false", "true"])
def test_two_agents_side_by_side_train_as_each_would_alone(tmp_path, random_start):
    limits = ("trainer.frames=400", "evaluation.interval=200", f"start.anywhere={random_start}")
    _, together = train(tmp_path / "both", *limits, "trainer.seeds=[3,7]")
    for index, seed in enumerate((3, 7)):
        _, alone = train(tmp_path / f"alone {seed}", *limits, f"seed={seed}")
        assert torch.equal(parameters(together, index), parameters(alone))
        for name in ("metrics.csv", "evaluations.csv"):
            ours, theirs = (read_rows(tmp_path / folder / name) for folder in (f"both/{seed}", f"alone {seed}"))
            assert ours == theirs
        ours, theirs = (load(tmp_path / folder / "train.mcap") for folder in (f"both/{seed}", f"alone {seed}"))
        assert (ours == theirs).all()


def test_an_agent_that_is_done_leaves_the_others_to_go_on(tmp_path):
    limits = ("trainer.episodes=8", "trainer.frames=100000", "env.num_envs=1", FEW_UPDATES)
    trainer, _ = train(tmp_path / "both", *limits, "trainer.seeds=[0,1]")
    frames = [run.status.frames for run in trainer.runs]
    assert [run.episodes for run in trainer.runs] == [8, 8]
    assert frames[0] != frames[1]
    for seed, count in enumerate(frames):
        alone, _ = train(tmp_path / f"alone {seed}", *limits, f"seed={seed}")
        assert alone.frames == count == len(load(tmp_path / "both" / str(seed) / "train.mcap"))
        assert alone.runs[0].last.measures() == trainer.runs[seed].last.measures()


def test_the_run_ends_at_the_episode_limit(tmp_path):
    trainer, _ = train(tmp_path, "trainer.episodes=3", "trainer.frames=100000", "env.num_envs=1", FEW_UPDATES)
    assert trainer.runs[0].episodes == 3
    assert trainer.frames < 1000


def test_stop_ends_the_run_after_the_round(tmp_path):
    pipeline = build_pipeline(compose("env.num_envs=4"))
    with RunFolder(tmp_path) as folder:
        trainer = Trainer(pipeline, [folder])
        trainer.run([AfterRounds(lambda running: running.stop() if running.frames >= 40 else None)])
    assert trainer.frames == 40
    assert trainer.runs[0].last is None
    assert (tmp_path / "checkpoints" / "last.pt").exists()


def test_evaluations_come_at_their_interval_for_any_number_of_cars(tmp_path):
    train(tmp_path, "env.num_envs=3", "evaluation.interval=100", "env.max_steps=50", FEW_UPDATES)
    with (tmp_path / "evaluations.csv").open() as file:
        frames = [int(row["frames"]) for row in csv.DictReader(file)]
    assert frames == [102, 201, 300, 402]


def test_a_loss_that_is_not_a_number_stops_the_run(tmp_path):
    with pytest.raises(
        CarrlError,
        match=r"the loss is nan at update [\d,]+, frame [\d,]+, of seed 0: the rewards of its minibatch are -?\d+",
    ):
        train(tmp_path, "optimizer.lr=1e15", "trainer.frames=3000", "start.anywhere=true")


@pytest.mark.parametrize(
    "override",
    [
        "trainer.frames=0",
        "trainer.episodes=-1",
        "evaluation.interval=0",
        "seed=-1",
        "seed=1.5",
        "trainer.seeds=[]",
        "trainer.seeds=[1,1]",
        "trainer.seeds=[0,-1]",
        "trainer.seeds=[0.5]",
    ],
)
def test_limits_that_allow_nothing_are_refused(override):
    with pytest.raises(ConfigError, match=r"must be|must name"):
        build_pipeline(compose(override))


def test_seeds_may_be_named_as_a_range():
    assert TrainingPlan(1, 1, seeds=["0..3", 7]).replicate_seeds(5) == [0, 1, 2, 3, 7]
    assert TrainingPlan(1, 1).replicate_seeds(5) == [5]
    with pytest.raises(ConfigError, match=r"trainer.seeds has '3..1'; write seeds as"):
        TrainingPlan(1, 1, seeds=["3..1"]).replicate_seeds(5)


def test_the_configuration_is_found():
    assert (config_dir() / "train.yaml").is_file()


CIRCUITS = ("track=circuits", "track.count=3", "track.validation=2", "evaluation.interval=200", "env.max_steps=20")


def test_several_circuits_are_learnt_on_and_others_are_driven_without_exploration(tmp_path):
    trainer, pipeline = train(tmp_path, *CIRCUITS, "start.anywhere=true", FEW_UPDATES)
    assert set(load(tmp_path / "train.mcap")["track"].tolist()) == {0, 1, 2}
    names = [track.name for track in pipeline.source.env.tracks]
    assert names == ["random-1000", "random-1001", "random-1002"]
    assert [track.name for track in pipeline.world.circuits.validation] == ["random-1003", "random-1004"]
    (run,) = trainer.runs
    assert len(run.best.rollouts) == 2
    rows = read_rows(tmp_path / "evaluations.csv")
    assert [row["drives"] for row in rows] == ["2", "2"]
    assert float(rows[-1]["progress"]) == pytest.approx(sum(drive.progress for drive in run.last.rollouts) / 2)


def test_networks_are_tried_out_from_several_places(tmp_path):
    trainer, pipeline = train(tmp_path, *CIRCUITS, "evaluation.starts=3", FEW_UPDATES)
    (run,) = trainer.runs
    lengths = [track.length for track in pipeline.world.circuits.validation]
    starts = [length * share / 3 for length in lengths for share in range(3)]
    assert [drive.start for drive in run.last.rollouts] == pytest.approx(starts, rel=1e-6)
    assert read_rows(tmp_path / "evaluations.csv")[-1]["drives"] == "6"
    with pytest.raises(ConfigError, match=r"evaluation.starts is 0; it must be a whole number from 1 to 1000"):
        build_pipeline(compose("evaluation.starts=0"))


def test_networks_are_tried_out_by_several_laps_in_a_row(tmp_path):
    trainer, pipeline = train(tmp_path, *CIRCUITS, "evaluation.laps=2")
    (run,), world = trainer.runs, pipeline.world
    evaluator = TrackEvaluator(world, world.circuits.validation, starts=1, laps=2)
    expected = [drive.measures() for (drive,) in evaluator.evaluate(trainer.algorithm.greedy_policy)]
    assert [drive.measures() for drive in run.last.rollouts] == expected
    (once,) = train(tmp_path / "once", *CIRCUITS)[0].runs
    assert run.last.measures()["progress"] < once.last.measures()["progress"]
    with pytest.raises(ConfigError, match=r"evaluation.laps is 0; it must be a whole number from 1 to 1000"):
        build_pipeline(compose("evaluation.laps=0"))


def test_agents_side_by_side_are_tried_out_on_every_circuit_as_each_alone(tmp_path):
    together, _ = train(tmp_path / "both", *CIRCUITS, "trainer.seeds=[3,4]", FEW_UPDATES)
    for index, seed in enumerate((3, 4)):
        alone, _ = train(tmp_path / f"alone-{seed}", *CIRCUITS, f"seed={seed}", FEW_UPDATES)
        assert together.runs[index].last.measures() == alone.runs[0].last.measures()


def test_several_env_steps_may_share_an_update(tmp_path):
    _, pipeline = train(tmp_path, "trainer.frames_per_update=5", "replay_buffer.batch_size=32")
    # As above, the round that fills the buffer counts: 400 - 24 env steps, of which the last one waits.
    assert pipeline.learner.updates == (400 - 32 + 8) // 5


def test_fewer_than_one_env_step_for_an_update_is_refused():
    with pytest.raises(ConfigError, match=r"trainer\.frames_per_update is 0; it must be at least 1"):
        TrainingPlan(1, 1, frames_per_update=0)
