"""Loggers beside the tables: what they get, that they change nothing, and what happens where they fail."""

import csv
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest
import torch

from carrl.cli.main import main
from carrl.errors import ConfigError
from carrl.train import scalars as module
from carrl.train.scalars import Row, Scalars, make_tensorboard

TINY = ["track=oval", "env.num_envs=8", "trainer.frames=160", "evaluation.interval=80"]
TINY += ["env.max_steps=100", "replay_buffer.batch_size=16"]


class Recorder:
    """A logger that keeps what it gets."""

    def __init__(self, works=True):
        self.rows, self.hparams, self.closed, self.works = [], {}, False, works

    def log_hparams(self, values):
        self.hparams = values

    def log_metrics(self, values, step):
        if not self.works:
            raise OSError("disk full")
        self.rows.append((step, dict(values)))

    def close(self):
        self.closed = True


def test_figures_are_grouped_and_what_is_no_number_is_left_out():
    logger = Recorder()
    scalars = Scalars(logger, {"optimizer": {"lr": 0.1}, "trainer": {"seeds": None}})
    scalars.add("training", 64, {"loss": float("nan"), "epsilon": 0.5, "ended": "collision", "lap": True})
    assert logger.rows == []  # written together with what comes within half a second
    scalars.close()
    assert logger.rows == [(64, {"training/epsilon": 0.5, "training/lap": 1.0})]
    assert logger.hparams == {"optimizer.lr": 0.1, "trainer.seeds": "None"}
    assert logger.closed


def test_figures_are_written_once_half_a_second_has_passed(monkeypatch):
    logger = Recorder()
    scalars = Scalars(logger, None)
    monkeypatch.setattr(module, "WRITTEN_WITHIN_S", 0.0)
    scalars.add("episode", 1, {"return": -200.0})
    assert len(logger.rows) == 1


def test_many_rows_can_be_written_at_once():
    written = []
    scalars = Scalars(Recorder(), None, written.extend)
    for step in (1, 2):
        scalars.add("episode", step, {"return": -200.0})
    scalars.close()
    assert [row.step for row in written] == [1, 2]
    assert all(isinstance(row, Row) for row in written)


def test_a_logger_that_fails_gets_no_more_figures_and_ends_no_training(caplog):
    logger = Recorder(works=False)
    scalars = Scalars(logger, None)
    scalars.add("episode", 1, {"return": -200.0})
    scalars.close()
    assert "Recorder failed, and gets no more figures: disk full" in caplog.text
    assert not logger.closed


@pytest.mark.parametrize("package", ["tensorboard", "wandb", "mlflow"])
def test_a_missing_package_is_named_with_its_remedy(package, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    assert main(["train", *TINY, f"logger={package}", f"hydra.run.dir={tmp_path}"]) == 2
    sentence = f"carrl: logger={package} needs {package}; pip install 'carrl[{package}]'\n"
    assert capsys.readouterr().err == sentence


def test_a_wrong_key_of_a_logger_is_named(tmp_path, capsys):
    assert main(["train", *TINY, "logger=wandb", "+logger.projekt=x", f"hydra.run.dir={tmp_path}"]) == 2
    assert "logger has no key 'projekt'; make_wandb takes project, offline" in capsys.readouterr().err


@pytest.fixture(scope="module")
def plain_run(tmp_path_factory):
    """A run with the tables alone."""
    folder = tmp_path_factory.mktemp("plain")
    assert main(["train", *TINY, "trainer.seeds=[3,4]", f"hydra.run.dir={folder}"]) == 0
    return folder


def train_with(logger, folder):
    """Trains the same in a process of its own, since the packages leave threads and settings behind."""
    if find_spec(logger) is None:
        pytest.skip(f"{logger} is not installed: pip install 'carrl[{logger}]'")
    command = [sys.executable, "-m", "carrl.cli.main", "train", *TINY, "trainer.seeds=[3,4]"]
    command += [f"logger={logger}", f"hydra.run.dir={folder}"]
    home = {"WANDB_MODE": "offline", "HOME": str(folder.parent), "XDG_CACHE_HOME": str(folder.parent / "cache")}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=os.environ | home)
    assert done.returncode == 0, done.stderr
    assert "failed" not in done.stderr
    return folder / "seed=3"


def assert_learnt_the_same(run, other):
    network, same = (torch.load(path / "checkpoints/last.pt", weights_only=True)["network"] for path in (run, other))
    assert all(torch.equal(network[key], same[key]) for key in network)


def episodes_of(run):
    with (run / "metrics.csv").open() as file:
        return [(int(row["frame"]), float(row["episode_return"])) for row in csv.DictReader(file)]


def test_tensorboard_has_what_the_tables_have_and_training_is_the_same(plain_run, tmp_path):
    run = train_with("tensorboard", tmp_path / "run")
    assert_learnt_the_same(run, plain_run / "seed=3")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    assert [(event.step, event.value) for event in events.Scalars("episode/return")] == episodes_of(run)
    assert [event.step for event in events.Scalars("evaluation/progress")] == [80, 160]


def test_wandb_keeps_a_run_offline_in_the_folder_and_training_is_the_same(plain_run, tmp_path):
    run = train_with("wandb", tmp_path / "run")
    assert_learnt_the_same(run, plain_run / "seed=3")
    (file,) = run.glob("wandb/offline-run-*/*.wandb")
    content = file.read_bytes()
    assert all(name in content for name in (b"episode/return", b"evaluation/progress", b"optimizer.lr"))


def test_mlflow_has_what_the_tables_have_and_training_is_the_same(plain_run, tmp_path):
    run = train_with("mlflow", tmp_path / "run")
    assert_learnt_the_same(run, plain_run / "seed=3")
    import sqlite3

    database = sqlite3.connect(run / "mlflow.db")
    rows = database.execute("SELECT step, value FROM metrics WHERE key = 'episode/return' ORDER BY step").fetchall()
    assert set(rows) == set(episodes_of(run))  # MLflow keeps one of two cars that crash alike at once
    assert database.execute("SELECT status FROM runs").fetchall() == [("FINISHED",)]
    assert ("0.001",) in database.execute("SELECT value FROM params WHERE key = 'optimizer.lr'").fetchall()
    database.close()


def test_tensorboard_goes_on_with_a_run(tmp_path):
    if find_spec("tensorboard") is None:
        pytest.skip("tensorboard is not installed: pip install 'carrl[tensorboard]'")
    for step in (1, 2):
        scalars = make_tensorboard(folder=tmp_path, config={"seed": 0})
        scalars.add("episode", step, {"return": -200.0})
        scalars.close()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("episode/return")] == [1, 2]


def test_mlflow_refuses_a_place_that_it_cannot_reach(tmp_path):
    if find_spec("mlflow") is None:
        pytest.skip("mlflow is not installed: pip install 'carrl[mlflow]'")
    with pytest.raises(ConfigError, match="cannot be used"):
        module.make_mlflow("carrl", "nowhere://", folder=tmp_path, config={})
