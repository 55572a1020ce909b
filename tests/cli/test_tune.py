"""`carrl tune`: its trials, giving up, going on, and bad input."""

import math
from importlib.util import find_spec
from types import SimpleNamespace

import pytest

from carrl.cli.main import main
from carrl.cli.tune import Choice, Range, _read_by_training, parse_search_space
from carrl.errors import ConfigError
from carrl.train.objectives import OBJECTIVES

needs_optuna = pytest.mark.skipif(find_spec("optuna") is None, reason="optuna is absent: pip install 'carrl[tune]'")
TINY = ["experiment=tune", "compile=false", "track=oval", "trainer.seeds=null", "trainer.frames=32"]
TINY += ["evaluation.interval=16", "replay_buffer.batch_size=16"]


def tune(folder, *arguments):
    return main(["tune", *TINY, *arguments, "--folder", str(folder)])


@needs_optuna
def test_the_best_settings_are_printed_ready_to_paste(tmp_path, capsys):
    assert tune(tmp_path, "--trials", "2") == 0
    output = capsys.readouterr()
    assert "2 trials" in output.out
    (command,) = (line.strip() for line in output.out.splitlines() if "carrl train" in line)
    assert command.startswith("carrl train experiment=tune compile=false")
    assert "optimizer.lr=" in command and "target_updater.period=" in command
    assert {path.name for path in tmp_path.iterdir()} == {"study.db", "trial=0", "trial=1"}
    assert "[2/2]" in output.err


@pytest.mark.parametrize(("search", "read"), [("experiment=tune", []), ("+search.optimizer.lr=[0.1]", ["seed=3"])])
def test_a_seed_is_printed_only_where_training_reads_it(search, read):
    assert [each for each in _read_by_training([search, "seed=3"]) if each != "experiment=tune"] == read


@needs_optuna
def test_an_experiment_of_ones_own_is_searched(tmp_path, capsys):
    (tmp_path / "conf" / "experiment").mkdir(parents=True)
    (tmp_path / "conf" / "experiment" / "mine.yaml").write_text(
        "# @package _global_\nsearch:\n  optimizer.lr: {choices: [0.001, 0.002]}\n"
    )
    own = ["--config-dir", str(tmp_path / "conf"), "experiment=mine", *TINY[1:]]
    assert main(["tune", *own, "--trials", "1", "--folder", str(tmp_path / "study")]) == 0
    assert f"carrl train --config-dir {tmp_path / 'conf'} experiment=mine" in capsys.readouterr().out


@needs_optuna
def test_a_study_goes_on_where_it_ended_but_not_with_something_else(tmp_path, capsys):
    assert tune(tmp_path, "--trials", "1") == 0
    assert tune(tmp_path, "--trials", "2") == 0
    assert "2 trials" in capsys.readouterr().out
    assert not (tmp_path / "trial=2").exists()
    assert tune(tmp_path, "--trials", "3", "--objective", "drive") == 2
    assert "has a study of something else" in capsys.readouterr().err


@needs_optuna
def test_a_study_without_its_database_does_not_overwrite_its_trials(tmp_path, capsys):
    assert tune(tmp_path, "--trials", "1") == 0
    (tmp_path / "study.db").unlink()
    summary = (tmp_path / "trial=0" / "summary.json").read_bytes()
    assert tune(tmp_path, "--trials", "1") == 2
    assert f"'{tmp_path / 'trial=0'}' has a run already" in capsys.readouterr().err
    assert (tmp_path / "trial=0" / "summary.json").read_bytes() == summary


@needs_optuna
def test_a_study_kept_elsewhere_does_not_overwrite_the_trials_of_another(tmp_path, capsys):
    (tmp_path / "trial=1").mkdir()
    (tmp_path / "trial=1" / "summary.json").write_text("work")
    storage = f"sqlite:///{tmp_path}/elsewhere.db"
    assert tune(tmp_path / "study", "--trials", "1", "--storage", storage) == 0
    assert tune(tmp_path, "--trials", "2", "--storage", storage) == 2
    assert f"'{tmp_path / 'trial=1'}' has a run already" in capsys.readouterr().err
    assert (tmp_path / "trial=1" / "summary.json").read_text() == "work"


class Trial:
    """A trial that is hopeless after so many reports."""

    def __init__(self, hopeless_after):
        self.reports, self._hopeless_after = {}, hopeless_after

    def report(self, value, step):
        self.reports[step] = value

    def should_prune(self):
        return len(self.reports) >= self._hopeless_after


class Training:
    """A training whose cars' best drives make so much progress."""

    def __init__(self, frames, progress, first_lap=None):
        lap = SimpleNamespace(frame=first_lap) if first_lap else None
        measures = {"progress": progress, "lap_completed": bool(lap), "forward_share": 0.5, "near_wall_share": 0.25}
        best = SimpleNamespace(measures=lambda: measures)
        self.frames, self.runs, self.stopped = frames, [SimpleNamespace(first_lap=lap, best=best)], False

    def stop(self):
        self.stopped = True


@pytest.fixture
def judge_of():
    from carrl.cli.trials import PruningCallback

    config = {"trainer": {"frames": 1000}, "evaluation": {"interval": 250}}
    return lambda trial, objective="first_lap": PruningCallback(trial, OBJECTIVES[objective], config)


def test_a_hopeless_trial_is_stopped(judge_of):
    trial = Trial(hopeless_after=2)
    judge, first, second = judge_of(trial), Training(250, 0.1), Training(504, 0.25)
    judge.on_round(first)
    judge.on_round(Training(256, 0.1))  # no evaluation since
    assert (first.stopped, judge.verdict) == (False, None)
    judge.on_round(second)
    assert (second.stopped, judge.verdict) == (True, "pruned")
    assert trial.reports == {1: 1900.0, 2: 1750.0}


def test_a_trial_that_has_lapped_is_settled_and_still_measures_the_others(judge_of):
    trial, training = Trial(hopeless_after=9), Training(504, 1.0, first_lap=504)
    judge = judge_of(trial)
    judge.on_round(training)
    assert (training.stopped, judge.verdict, judge.value) == (True, "converged", 504.0)
    assert trial.reports == {2: 504.0, 3: 504.0, 4: 504.0}


def test_a_lap_is_worth_more_than_progress_and_a_smooth_one_more_still(judge_of):
    judge = judge_of(Trial(9), "drive")
    judge.on_round(Training(250, 0.9))
    assert judge.value == 0.9
    judge.on_round(Training(500, 1.0, first_lap=500))
    assert math.isclose(judge.value, 1.0 + 0.5 + 0.75)
    assert judge.verdict is None  # it may drive better yet


def test_a_search_space_has_ranges_and_choices():
    node = {"a.b": {"low": 1, "high": 8, "log": True}, "c": {"choices": [[16, 8], "dqn", 0.5, None]}}
    assert parse_search_space(node) == {"a.b": Range(1, 8, True), "c": Choice(("[16,8]", "dqn", "0.5", "null"))}


@pytest.mark.parametrize(
    "entry",
    [
        {"low": 1},
        {"low": 2, "high": 1},
        {"low": 0, "high": 1, "log": True},
        {"low": "x", "high": "y"},
        {"choices": []},
        {"choices": [1], "low": 0},
        3,
    ],
)
def test_a_wrong_search_space_is_named(entry):
    with pytest.raises(ConfigError, match=r"search\.a is .*; it must be choices: \[\.\.\.\] or low: and high:"):
        parse_search_space({"a": entry})


@needs_optuna
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["experiment=fast"], "the configuration has no search"),
        (["experiment=none"], "experiment has no option none; choose one of: brake, f1tenth, fast, generalist"),
        (["experiment=tune", "--trials", "0"], "--trials is 0"),
        (["experiment=tune", "data=log", "data.path=x.mcap"], "only training in the simulator can be tuned"),
        (["experiment=tune", "~search", "+search={optimizer.rl:{choices:[1]}}"], "optimizer.rl"),
        (["experiment=tune", "--timeout", "0"], "--timeout is 0.0; it must be a positive number of seconds"),
        (["experiment=tune", "--timeout", "nan"], "--timeout is nan; it must be a positive number of seconds"),
        (["experiment=tune", "--trials", "many"], "argument --trials: invalid int value: 'many'; carrl tune --help"),
        (["experiment=tune", "--trial-count", "3"], "unrecognized arguments: --trial-count"),
        (["experiment=tune", "optimizer.lr=1"], "optimizer.lr=1 has no effect, as search has optimizer.lr, which each"),
        (["experiment=tune", "+lr=1"], "there is no key lr; did you mean optimizer.lr?"),
        (
            ["experiment=tune", "seed=1,2"],
            "seed=1,2 has several values; choose one, or write a list as trainer.seeds=[A,B]",
        ),
        (["experiment=tune", "hydra.run.dir=x"], "hydra.run.dir=x has no effect on carrl tune; leave it out"),
        (["experiment=tune", "resume=x"], "resume is 'x'; it counts only where it is typed, as in carrl train resume="),
        (["experiment=tune", "--storage", "nowhere"], "--storage 'nowhere' cannot be used"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(arguments, message, tmp_path, capsys):
    assert main(["tune", *arguments, "--folder", str(tmp_path)]) == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1


@needs_optuna
def test_a_folder_that_is_a_file_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("kept")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        assert tune(folder) == 2
        assert f"--folder '{folder}' cannot be made: " in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "kept"


@needs_optuna
def test_a_folder_that_may_not_be_written_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("carrl.cli.tune.os.access", lambda path, mode: False)  # as for others than root
    assert tune(tmp_path) == 2
    assert capsys.readouterr().err == f"carrl: --folder '{tmp_path}' cannot be written to; choose another\n"


def test_tuning_without_optuna_is_refused_with_the_remedy(monkeypatch, capsys):
    monkeypatch.setattr("carrl.cli.tune.find_spec", lambda name: None)
    assert main(["tune", "experiment=tune"]) == 2
    assert capsys.readouterr().err == "carrl: carrl tune needs optuna; pip install 'carrl[tune]'\n"
