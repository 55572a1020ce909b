"""`carrl train data=log` as typed."""

import json

import pytest
import yaml

from carrl.cli.main import main
from carrl.evaluation.results import EvaluationResult
from carrl.sim.simulator import Simulator
from carrl.task.task import Task
from carrl.train.callbacks import Evaluator
from carrl.train.trainer import Trainer
from tests.data.logs import METADATA, logged_transitions, write_log

TINY = ["data=log", "data.updates=20", "replay_buffer.batch_size=4", "track=oval"]


@pytest.fixture(scope="module")
def log_path(tmp_path_factory):
    """A log of 10 transitions, in a folder whose name Hydra would not read unquoted."""
    folder = tmp_path_factory.mktemp("logs") / "seed=3"
    folder.mkdir()
    return write_log(folder / "train.mcap")


@pytest.fixture(scope="module")
def run(tmp_path_factory, log_path):
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("runs") / "offline"
    assert main(["train", *TINY, "loss=cql", f"data.path={log_path}", f"hydra.run.dir={folder}"]) == 0
    return folder


def test_a_run_on_a_log_leaves_its_results_in_one_folder_and_no_log(run):
    assert {path.name for path in run.iterdir()} == {
        ".hydra",
        "checkpoints",
        "evaluations.csv",
        "lap.png",
        "metrics.csv",
        "summary.json",
    }
    assert {path.name for path in (run / "checkpoints").glob("[bl]*")} == {"best.pt", "last.pt"}


def test_the_summary_has_all_usual_keys_and_the_transitions(run):
    summary = json.loads((run / "summary.json").read_text())
    usual = {"seed", "track", "episodes", "frames", "updates", "wall_time_s", "start_up_s", "first_update_s"}
    assert set(summary) == usual | {"finished", "first_lap", "evaluation", "last_evaluation", "transitions"}
    figures = {key: summary[key] for key in ("seed", "track", "episodes", "frames", "updates", "transitions")}
    assert figures == {"seed": 0, "track": "oval", "episodes": 0, "frames": 0, "updates": 20, "transitions": 10}
    assert summary["evaluation"] == summary["last_evaluation"]


def test_evaluate_drives_what_was_learnt(run, capsys):
    assert main(["evaluate", str(run), "--json"]) == 0
    (track,) = json.loads(capsys.readouterr().out)["tracks"]
    expected = json.loads((run / "summary.json").read_text())["evaluation"]
    assert {key: track["drives"][0][key] for key in expected} == expected


def test_the_same_seed_learns_the_same(run, log_path, tmp_path):
    overrides = [*TINY, "loss=cql", f"data.path={log_path}", f"hydra.run.dir={tmp_path}"]
    assert main(["train", *overrides]) == 0
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (run, tmp_path)]
    assert summaries[0]["evaluation"] == summaries[1]["evaluation"]


def test_several_seeds_leave_a_folder_each_and_print_a_table(log_path, tmp_path, capsys):
    overrides = [*TINY, f"data.path={log_path}", "trainer.seeds=[4..5]", f"hydra.run.dir={tmp_path}"]
    assert main(["train", *overrides]) == 0
    table = capsys.readouterr().out
    assert "2 seeds on track oval" in table and "transitions" in table and "frames" not in table
    assert {path.name for path in tmp_path.iterdir()} == {".hydra", "checkpoints", "seed=4", "seed=5"}
    config = yaml.safe_load((tmp_path / "seed=5" / ".hydra" / "config.yaml").read_text())
    assert (config["seed"], config["trainer"]["seeds"]) == (5, None)
    assert main(["evaluate", str(tmp_path / "seed=5")]) == 0


def test_one_seed_prints_what_it_learnt_from(log_path, tmp_path, capsys):
    assert main(["train", *TINY, f"data.path={log_path}", f"hydra.run.dir={tmp_path}"]) == 0
    output = capsys.readouterr()
    assert "transitions from logs" in output.out and "greedy lap" in output.out and "episodes" not in output.out
    assert "20 updates" in output.err


def test_a_list_of_logs_and_a_sweep_over_losses(log_path, tmp_path):
    overrides = [*TINY, f"data.path=[{log_path},{log_path}]", f"hydra.sweep.dir={tmp_path}"]
    assert main(["train", "-m", *overrides, "loss=dqn,double_dqn,cql"]) == 0
    summaries = [json.loads(path.read_text()) for path in tmp_path.rglob("summary.json")]
    assert [summary["transitions"] for summary in summaries] == [20, 20, 20]


def test_a_relative_path_counts_from_where_the_command_is_typed(log_path, tmp_path, monkeypatch):
    monkeypatch.chdir(log_path.parent)
    assert main(["train", *TINY, "data.path=train.mcap", f"hydra.run.dir={tmp_path}"]) == 0


BAD_INPUT = [
    ([], "data.path has no value; give it one, as in carrl train ... data.path=FILE"),
    (["data.path=nowhere.mcap"], "nowhere.mcap"),
    (["data.path=empty.mcap"], "data.path has 0 transitions, fewer than the 4 of one minibatch"),
    (["data.path=train.mcap", "replay_buffer.batch_size=11"], "data.path has 10 transitions, fewer than the 11"),
    (["data.path=train.mcap", "sensor.rays=9"], "the network reads 9 (9 of rays)"),
    (["data.path=train.mcap", "observation=rays_and_last_action"], "the network reads 10 (7 of rays, 3 of"),
    (["data.path=train.mcap", "sensor.max_range=15"], "set sensor.max_range=10.0"),
    (["data.path=other.mcap"], "its actions are ['left', 'right']"),
    (["data.path=text.mcap"], "text.mcap"),
    (["data.path=train.mcap", "data.updates=0"], "data.updates is 0"),
    (["data.path=[]"], "data.path names no log"),
    (["data.path=train.mcap", "loss=cql", "loss.alpha=-1"], "loss.alpha is -1; it must be a number of at least 0"),
    (["data.path=train.mcap", "replay_buffer.capacity=x"], "replay_buffer.capacity is 'x'"),
]


@pytest.mark.parametrize(("overrides", "message"), BAD_INPUT, ids=[" ".join(overrides) for overrides, _ in BAD_INPUT])
def test_bad_input_is_one_sentence_and_exit_code_2(overrides, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "train.mcap")
    write_log(tmp_path / "empty.mcap", logged_transitions()[:0])
    write_log(tmp_path / "other.mcap", metadata=METADATA | {"action_names": '["left", "right"]'})
    (tmp_path / "text.mcap").write_text("not a log")
    assert main(["train", *TINY, *overrides]) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert output.err.count("\n") == 1
    assert output.out == ""


READ_BY_THE_SIMULATOR_ONLY = [
    "trainer.frames=100",
    "trainer.frames_per_update=2",
    "exploration=constant",
    "exploration.decay_rate=0.1",
    "env.num_envs=4",
    "evaluation.interval=5",
    "collector.steps_per_batch=2",
    "recorder.every_nth_episode=1",
    "start.anywhere=true",
]


@pytest.mark.parametrize("sweep", [[], ["-m", "loss=dqn,cql"]], ids=["run", "sweep"])
@pytest.mark.parametrize("override", READ_BY_THE_SIMULATOR_ONLY)
def test_what_only_the_simulator_reads_is_refused_where_it_is_typed(
    override, sweep, log_path, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *sweep, *TINY, f"data.path={log_path}", override]) == 2
    sentence = f"carrl: {override} has no effect with data=log, which learns without the simulator, for data.updates; "
    assert capsys.readouterr().err == f"{sentence}leave it out\n"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_an_experiments_own_values_and_no_recorder_go_with_a_log(log_path, tmp_path):
    overrides = ["experiment=fast", *TINY, f"data.path={log_path}", "recorder=null", "observation=rays"]
    assert main(["train", *overrides, f"hydra.run.dir={tmp_path}"]) == 0


@pytest.fixture(scope="module")
def fast_log(tmp_path_factory):
    """The log of `experiment=fast`, seed 0."""
    folder = tmp_path_factory.mktemp("fast")
    assert main(["train", "experiment=fast", f"hydra.run.dir={folder}"]) == 0
    return folder / "train.mcap"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize(
    "loss", ["cql", *(pytest.param(loss, marks=pytest.mark.exhaustive) for loss in ("double_dqn", "dqn"))]
)
def test_the_log_of_one_fast_run_teaches_a_lap_without_a_single_simulator_step(loss, fast_log, tmp_path, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the simulator is touched in training")

    with monkeypatch.context() as until_learnt:
        for owner, name in ((Simulator, "__init__"), (Simulator, "start"), (Simulator, "step"), (Task, "__init__")):
            until_learnt.setattr(owner, name, refuse)
        drive = Evaluator.drive

        def drive_at_the_end(evaluator: Evaluator, trainer: Trainer) -> list[EvaluationResult]:
            assert trainer.updates == 20_000
            until_learnt.undo()
            return drive(evaluator, trainer)

        until_learnt.setattr(Evaluator, "drive", drive_at_the_end)
        assert main(["train", "data=log", f"data.path={fast_log}", f"loss={loss}", f"hydra.run.dir={tmp_path}"]) == 0
    evaluation = json.loads((tmp_path / "summary.json").read_text())["evaluation"]
    assert evaluation["lap_completed"]


def test_report_shows_a_run_that_has_no_episodes(run, capsys):
    assert main(["report", str(run)]) == 0
    assert f"| {run.name} | 0 | 0 |" in capsys.readouterr().out
