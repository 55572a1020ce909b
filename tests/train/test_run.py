"""`carrl.train` and `carrl.Run`: training and its results from Python."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch

import carrl
from carrl.cli.main import main
from carrl.errors import CarrlError, CheckpointError, ConfigError
from carrl.train.callbacks import Callback
from carrl.train.checkpoint import load_checkpoint
from carrl.train.files import checkpoint_path

TINY = ["track=oval", "env.num_envs=8", "trainer.frames=160", "evaluation.interval=80"]
TINY += ["replay_buffer.batch_size=32"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return carrl.train("fast", seed=3, loss="double_dqn", overrides=TINY, folder=tmp_path_factory.mktemp("run") / "one")


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "two"
    return carrl.train("fast", overrides=[*TINY, "trainer.seeds=[3,4]"], folder=folder)


def test_it_trains_as_the_command_line_does_and_prints_nothing(run, tmp_path, capfd):
    again = carrl.train("fast", seed=3, loss="double_dqn", overrides=TINY, folder=tmp_path / "python")
    assert capfd.readouterr() == ("", "")
    assert main(["train", "experiment=fast", "seed=3", *TINY, f"hydra.run.dir={tmp_path / 'typed'}"]) == 0
    networks = [
        load_checkpoint(checkpoint_path(folder, "last"))["network"]
        for folder in (run.folder, again.folder, tmp_path / "typed")
    ]
    for name, value in networks[0].items():
        assert torch.equal(value, networks[1][name])
        assert torch.equal(value, networks[2][name])
    assert {path.name for path in run.folder.iterdir()} == {path.name for path in (tmp_path / "typed").iterdir()}


def test_values_are_given_in_any_form(tmp_path):
    run = carrl.train(
        loss="cql",
        compile=False,
        track="oval",
        env={"num_envs": np.int64(4)},
        network={"hidden_sizes": (8, 8)},
        overrides={"trainer.frames": 40, "trainer.seeds": None, "evaluation": {"interval": 20}},
        folder=tmp_path / "with = and , in it",
    )
    assert run.config["network"]["hidden_sizes"] == [8, 8]
    assert (run.config["env"]["num_envs"], run.config["trainer"]["seeds"]) == (4, None)
    assert run.summary["frames"] == 40


def test_a_run_offers_its_summary_policy_and_log(run):
    assert run.summary["seed"] == run.config["seed"] == 3
    assert run.replicates == [run]
    observation = np.random.default_rng(0).random((5, 7))
    actions = run.policy(observation)
    assert (type(actions), actions.shape) == (np.ndarray, (5,))
    assert run.policy(torch.as_tensor(observation)).tolist() == actions.tolist()
    assert [run.policy(each) for each in observation] == actions.tolist()
    with run.log as log:
        assert log.transitions == 160


def test_an_evaluation_is_what_the_command_line_prints(run, capsys):
    assert main(["evaluate", str(run.folder), "--track", "oval", "--starts", "2", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    for track in ("oval", carrl.Track.load("oval")):
        assert json.loads(json.dumps(run.evaluate(track, starts=2))) == printed


def test_an_old_run_is_opened(run):
    again = carrl.Run.load(str(run.folder))
    assert again.summary == run.summary
    assert again.config == run.config


def test_several_seeds_are_replicates(seeds):
    assert [summary["seed"] for summary in seeds.summary] == [3, 4]
    assert [replicate.config["seed"] for replicate in seeds.replicates] == [3, 4]
    assert seeds.replicates[1].policy(np.zeros(7)) in (0, 1, 2)
    with pytest.raises(CarrlError, match=r"has 2 seeds; take the policy of one: run\.replicates\[0\]\.policy"):
        seeds.policy  # noqa: B018
    assert len(seeds.evaluate("oval")["runs"]) == 2


def test_a_run_goes_on(tmp_path):
    run = carrl.train("fast", overrides=TINY, folder=tmp_path / "run")
    longer = carrl.train(resume=run.folder, overrides={"trainer.frames": 240})
    assert longer.summary["frames"] == 240


def test_observers_follow_and_may_stop(tmp_path):
    class Stopper(Callback):
        rounds, has_ended = 0, False

        def on_round(self, trainer):
            self.rounds += 1
            if trainer.frames >= 80:
                trainer.stop()

        def on_end(self):
            self.has_ended = True

    stopper = Stopper()
    run = carrl.train("fast", overrides=TINY, folder=tmp_path / "run", callbacks=[stopper])
    assert (stopper.rounds, stopper.has_ended) == (10, True)
    assert (run.summary["frames"], run.summary["finished"]) == (80, False)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"sedd": 1}, "there is no key sedd; did you mean seed?"),
        ({"loss": "dqnn"}, "loss has no option dqnn; did you mean dqn"),
        ({"experiment": "fsat"}, "experiment has no option fsat; did you mean fast"),
        ({"env": {"num_envs": "many"}}, "env.num_envs is 'many'; it must be of type int"),
        ({"loss": object()}, "is no value of a configuration"),
        ({"overrides": ["seed=1,2"]}, "seed=1,2 has several values; choose one"),
        (
            {"overrides": ["hydra.run.dir=x"]},
            "hydra.run.dir=x has no effect on carrl.train; leave it out (folder= names",
        ),
        ({"overrides": ["search.a=1"]}, "search.a=1 has no effect on carrl train; carrl tune searches"),
    ],
)
def test_a_mistake_is_one_error_and_leaves_nothing_behind(values, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        carrl.train(**values)
    assert says in str(caught.value)
    assert not list(tmp_path.rglob("*.yaml"))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"folder": "elsewhere"}, "folder and config_dir have no effect where a run is resumed"),
        ({"config_dir": "."}, "folder and config_dir have no effect where a run is resumed"),
        ({"callbacks": [3]}, "callbacks is"),
    ],
)
def test_what_has_no_effect_on_a_resumed_run_is_refused(run, values, says):
    with pytest.raises(ConfigError, match=says):
        carrl.train(resume=run.folder, **values)


def test_a_policy_that_there_is_not_is_refused(run):
    with pytest.raises(ConfigError, match="policy is 'quick'; it must be greedy, rule, random, follow_the_gap, line"):
        run.evaluate("oval", policy="quick")


@pytest.mark.parametrize("observation", [[0.5] * 8, "x", None, np.zeros((2, 2, 7))])
def test_an_observation_of_another_size_is_refused(run, observation):
    with pytest.raises(ConfigError, match="observation"):
        run.policy(observation)


def test_a_run_of_an_older_version_is_called_so(run, tmp_path):
    config = json.loads(json.dumps(run.config))
    for key in ("action", "observation", "start"):
        del config[key]
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text(json.dumps(config))
    with pytest.raises(ConfigError, match="it was trained by an older version of CarRL"):
        carrl.Run.load(tmp_path)


def test_a_folder_that_has_a_run_is_refused(run):
    with pytest.raises(ConfigError, match="has a run already"):
        carrl.train("fast", overrides=TINY, folder=run.folder)


def test_a_folder_that_has_none_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match="does not exist"):
        carrl.Run.load(tmp_path)


def test_the_door_costs_nothing_until_it_is_opened():
    program = "import sys, carrl; carrl.train; print(sorted({'hydra', 'torch', 'carrl.train.run'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "[]\n"
