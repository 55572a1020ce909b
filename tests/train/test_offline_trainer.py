"""Learning from logs, on short runs."""

import csv
import math
from contextlib import ExitStack

import pytest
import torch

from carrl.errors import CarrlError, ConfigError
from carrl.sim.simulator import Simulator
from carrl.task.task import Task
from carrl.train.build import build_pipeline, learns_from_logs
from carrl.train.checkpoint import load_checkpoint
from carrl.train.folder import RunFolder
from carrl.train.plan import OfflinePlan
from carrl.train.trainer import Trainer
from tests.configs import compose
from tests.data.logs import logged_transitions, write_log
from tests.train.rounds import AfterRounds


@pytest.fixture(scope="module")
def log_path(tmp_path_factory):
    """A log of 10 transitions."""
    return write_log(tmp_path_factory.mktemp("logs") / "train.mcap")


def build(log_path, *overrides):
    paths = [f"data.path={log_path}", "data.updates=20", "replay_buffer.batch_size=4", "track=oval"]
    return build_pipeline(compose("data=log", *paths, *overrides))


def train(pipeline, folder, on_round=lambda _: None):
    """A finished trainer; with several replicates their folders are named after their seeds."""
    with ExitStack() as stack:
        seeds = [replicate.seed for replicate in pipeline.algorithm.replicates]
        paths = [folder / str(seed) if len(seeds) > 1 else folder for seed in seeds]
        trainer = Trainer(pipeline, [stack.enter_context(RunFolder(path)) for path in paths])
        trainer.run([AfterRounds(on_round)])
    return trainer


def parameters(pipeline, replicate=0):
    network = pipeline.algorithm.networks[replicate]
    return torch.cat([parameter.detach().flatten() for parameter in network.parameters()])


def read_rows(path):
    """A table without its times."""
    with path.open() as file:
        return [{key: value for key, value in row.items() if key != "wall_time_s"} for row in csv.DictReader(file)]


def test_only_data_log_learns_from_logs():
    assert not learns_from_logs(compose())
    assert not learns_from_logs({})  # a configuration from before there was a choice
    assert learns_from_logs(compose("data=log"))


def test_no_simulator_is_touched_before_everything_is_learnt(log_path, tmp_path, monkeypatch):
    moves = []

    def watch(owner, name):
        original = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *args, **options: moves.append(name) or original(*args, **options))

    for owner, name in ((Simulator, "__init__"), (Simulator, "start"), (Simulator, "step"), (Task, "__init__")):
        watch(owner, name)
    pipeline = build(log_path)
    touched_in_training = []
    train(pipeline, tmp_path, lambda trainer: touched_in_training.append(list(moves)))
    assert touched_in_training == [[]]
    assert pipeline.learner.updates == 20
    assert moves[:3] == ["__init__", "__init__", "start"] and moves.count("start") == 1  # the drive at the end
    assert "step" in moves and moves.count("step") == len(moves) - 3


def test_there_are_as_many_updates_as_asked_for_and_the_target_follows_each_period(log_path, tmp_path):
    pipeline = build(log_path, "data.updates=20", "target_updater.period=8")
    (replicate,) = pipeline.algorithm.replicates
    copies, original = [], replicate.target_updater.step

    def watched_step(count):
        before = replicate.loss.target_value_network_params.clone()
        original(count)
        if (replicate.loss.target_value_network_params != before).any():
            copies.append(pipeline.learner.updates)

    replicate.target_updater.step = watched_step
    trainer = train(pipeline, tmp_path)
    assert trainer.updates == 20
    assert copies == [8, 16]


def test_data_log_brings_a_pace_of_its_own_that_overrides_still_change():
    config = compose("data=log")
    assert (config["target_updater"]["period"], config["optimizer"]["lr"]) == (500, 3e-4)
    assert compose("data=log", "target_updater.period=7")["target_updater"]["period"] == 7


def test_metrics_tell_how_learning_goes_and_the_last_network_is_the_result(log_path, tmp_path):
    pipeline = build(log_path, "data.updates=600")
    trainer = train(pipeline, tmp_path)
    rows = read_rows(tmp_path / "metrics.csv")
    assert [int(row["updates"]) for row in rows] == [250, 500, 600]
    assert set(rows[0]) == {"updates", "loss", "td_error", "logged_value", "greedy_value", "agreement"}
    last = {key: float(value) for key, value in rows[-1].items()}
    assert float(rows[0]["td_error"]) > last["td_error"] > 0
    assert last["greedy_value"] >= last["logged_value"]
    assert 0 <= last["agreement"] <= 1
    for name in ("last", "best"):
        state = load_checkpoint(tmp_path / "checkpoints" / f"{name}.pt")
        assert (state["frames"], state["episodes"]) == (0, 0)
        assert all(
            torch.equal(state["network"][key], value)
            for key, value in pipeline.algorithm.networks[0].state_dict().items()
        )
    (run,) = trainer.runs
    assert run.best.measures() == run.last.measures()
    (drive,) = read_rows(tmp_path / "evaluations.csv")
    assert drive["frames"] == "0"


def test_the_measures_are_means_over_the_logged_transitions(log_path, tmp_path):
    pipeline = build(log_path, "data.updates=1", "trainer.seeds=[0,1]")
    train(pipeline, tmp_path)
    for index, replicate in enumerate(pipeline.algorithm.replicates):
        (row,) = read_rows(tmp_path / str(replicate.seed) / "metrics.csv")
        stored = pipeline.replay_buffer[:][:, index]
        with torch.no_grad():
            values = replicate.network(stored.select("observation"))["action_value"]
        taken = values.gather(-1, stored["action"][:, None])
        assert float(row["logged_value"]) == pytest.approx(taken.mean().item(), abs=1e-5)
        assert float(row["greedy_value"]) == pytest.approx(values.max(-1).values.mean().item(), abs=1e-5)
        assert float(row["agreement"]) == pytest.approx((values.argmax(-1) == stored["action"]).float().mean().item())


@pytest.mark.parametrize("loss", ["dqn", "double_dqn", "cql"])
def test_two_agents_side_by_side_learn_as_each_would_alone(loss, log_path, tmp_path):
    together = build(log_path, f"loss={loss}", "trainer.seeds=[3,7]")
    train(together, tmp_path / "both")
    for index, seed in enumerate((3, 7)):
        alone = build(log_path, f"loss={loss}", f"seed={seed}")
        train(alone, tmp_path / f"alone {seed}")
        assert torch.equal(parameters(together, index), parameters(alone))
        for name in ("metrics.csv", "evaluations.csv"):
            ours, theirs = (read_rows(tmp_path / folder / name) for folder in (f"both/{seed}", f"alone {seed}"))
            assert ours == theirs
    assert not torch.equal(parameters(together, 0), parameters(together, 1))


def test_cql_learns_something_else_than_double_dqn(log_path, tmp_path):
    weights = []
    for index, overrides in enumerate((["loss=double_dqn"], ["loss=cql", "loss.alpha=0.0"], ["loss=cql"])):
        pipeline = build(log_path, *overrides)
        train(pipeline, tmp_path / str(index))
        weights.append(parameters(pipeline))
    torch.testing.assert_close(weights[0], weights[1])
    assert not torch.allclose(weights[0], weights[2])


def test_stop_ends_the_run_after_the_round_and_keeps_the_network(log_path, tmp_path):
    trainer = train(build(log_path, "data.updates=10000"), tmp_path, lambda running: running.stop())
    assert trainer.updates == 250
    assert trainer.runs[0].last is None
    assert (tmp_path / "checkpoints" / "last.pt").exists()


def test_a_loss_that_is_not_a_number_stops_the_run(tmp_path):
    transitions = logged_transitions()
    transitions["next", "reward"].fill_(math.nan)
    path = write_log(tmp_path / "train.mcap", transitions)
    with pytest.raises(CarrlError, match=r"the loss is nan at update 1 of seed 0: the rewards of its minibatch"):
        train(build(path), tmp_path)


def test_several_logs_are_learnt_from_together(log_path, tmp_path):
    other = write_log(tmp_path / "other.mcap")
    pipeline = build(log_path, f"data.path=[{log_path},{other}]")
    assert len(pipeline.replay_buffer) == 20


@pytest.mark.parametrize(("capacity", "room"), [(100, 100), (10, 10), (6, 12), (4, 12)])
def test_the_buffer_has_room_for_all_in_multiples_of_its_capacity(capacity, room, log_path):
    pipeline = build(log_path, f"replay_buffer.capacity={capacity}")
    assert len(pipeline.replay_buffer) == 10
    assert pipeline.replay_buffer.storage.max_size == room


def test_fewer_transitions_than_a_minibatch_are_refused(log_path):
    with pytest.raises(
        ConfigError, match=r"data\.path has 10 transitions, fewer than the 11 of one minibatch; name more"
    ):
        build(log_path, "replay_buffer.batch_size=11")


def test_plans_that_allow_nothing_are_refused():
    with pytest.raises(ConfigError, match=r"data\.updates is 0"):
        OfflinePlan("a.mcap", 0)
    with pytest.raises(ConfigError, match=r"data\.path names no log"):
        OfflinePlan([], 1)


def test_200_updates_with_cql_by_machine_code_equal_200_eager_ones(log_path, caplog):
    overrides = ("loss=cql", "trainer.seeds=[1,2]", "target_updater.period=50", "optimizer.lr=1e-3")
    eager, compiled = build(log_path, *overrides), build(log_path, *overrides, "compile=true")
    for _ in range(200):
        eager.learner.learn(1)
        compiled.learner.learn(1)
        torch.testing.assert_close(compiled.learner.losses, eager.learner.losses, rtol=1e-5, atol=0)
    assert not any("eagerly" in record.message for record in caplog.records)
    for ours, theirs in zip(compiled.algorithm.replicates, eager.algorithm.replicates, strict=True):
        for name in ("value_network_params", "target_value_network_params"):
            tensors = (getattr(replicate.loss, name).values(True, True) for replicate in (ours, theirs))
            for fused, plain in zip(*tensors, strict=True):
                assert ((fused - plain).norm() / plain.norm()).item() < 1e-5
