"""`carrl evaluate SWEEP`: a folder of runs."""

import json
import shutil

import pytest

from carrl.cli.main import main
from carrl.train.run import Run

TINY = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=32", "replay_buffer.batch_size=8"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """The folder of a sweep of two runs, and one that was never finished."""
    folder = tmp_path_factory.mktemp("sweeps") / "one"
    assert main(["train", "-m", *TINY, "loss=dqn,double_dqn", f"hydra.sweep.dir={folder}"]) == 0
    shutil.copytree(folder / "loss=dqn", folder / "loss=broken")
    (folder / "loss=broken" / "summary.json").unlink()
    (folder / "loss=broken" / "job.json").unlink()
    return folder


def test_each_run_is_evaluated_as_it_would_be_alone(sweep, capsys):
    assert main(["evaluate", str(sweep), "--track", "paper", "--starts", "2", "--json"]) == 0
    output = capsys.readouterr()
    document = json.loads(output.out)
    assert [run["run"] for run in document["runs"]] == ["loss=double_dqn", "loss=dqn"]
    for run in document["runs"]:
        alone = json.loads(json.dumps(Run(run["folder"]).evaluate("paper", starts=2)))
        assert (run["all"], run["tracks"]) == (alone["all"], alone["tracks"])
    assert list(document["left_out"]) == ["loss=broken"]
    assert "warning: left out 'loss=broken': no summary.json" in output.err
    assert "[2/2] loss=dqn" in output.err


def test_the_table_has_a_row_for_each_run_and_one_for_the_rule(sweep, capsys):
    assert main(["evaluate", str(sweep)]) == 0
    printed = capsys.readouterr().out
    assert "greedy policy of each run in" in printed
    first_cells = [line.split("│")[1].strip() for line in printed.splitlines() if line.startswith("│")]
    assert first_cells == ["loss=double_dqn", "loss=dqn", "rule"]


def test_what_cannot_be_done_with_many_runs_is_refused(sweep, tmp_path, capsys):
    assert main(["evaluate", str(sweep), "--speed-trace", str(tmp_path / "trace.csv")]) == 2
    assert "--speed-trace is of one run" in capsys.readouterr().err
    shutil.copytree(sweep / "loss=broken", tmp_path / "sweep" / "loss=broken")
    assert main(["evaluate", str(tmp_path / "sweep")]) == 2
    assert f"no run in '{tmp_path / 'sweep'}' has finished" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main(["evaluate", str(tmp_path / "empty")]) == 2
    assert "config.yaml' does not exist" in capsys.readouterr().err
