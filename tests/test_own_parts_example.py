"""Parts of one's own, from outside the package: examples/own_parts through the command line and from Python."""

import json
import math
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import carrl
from carrl.cli.main import main
from carrl.errors import ConfigError

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "own_parts"
SHORT = ["compile=false", "trainer.frames=80", "evaluation.interval=40", "replay_buffer.batch_size=32"]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """No test finds the example's module already imported, or leaves it so."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "own_parts", raising=False)
    yield
    sys.modules.pop("own_parts", None)


@pytest.fixture
def road(tmp_path):
    path = tmp_path / "road.txt"
    angles = np.linspace(0, 2 * math.pi, 120, endpoint=False)
    np.savetxt(path, 40 + 6 * np.cos(3 * angles))
    return path


@pytest.fixture
def run(road, tmp_path, capsys):
    """The folder of a run of all own parts at once."""
    own = ["--config-dir", str(EXAMPLE / "conf"), "experiment=own", "track=polar", f"track.path={road}"]
    assert main(["train", *own, *SHORT, f"hydra.run.dir={tmp_path / 'run'}"]) == 0
    return tmp_path / "run"


def test_it_is_short():
    lines = sum(len(path.read_text().splitlines()) for path in EXAMPLE.glob("*.py"))
    assert lines <= 100


def test_the_page_about_own_parts_quotes_the_example_as_it_is():
    page = (EXAMPLE.parents[1] / "docs" / "own-parts.md").read_text()
    quoted = re.findall(r"^```(?:python|yaml)\n(?:# (conf/\S+)\n)?(.*?)^```", page, re.M | re.S)
    assert len(quoted) == 10
    for path, text in quoted:
        assert text in (EXAMPLE / (path or "own_parts.py")).read_text()


def test_a_run_says_how_to_open_it_again_and_opens_only_so(run, capsys):
    printed = capsys.readouterr().out
    (flag,) = json.loads((run / "summary.json").read_text())["trust"]
    assert f"carrl evaluate {run} --trust {flag}" in " ".join(printed.split())
    del sys.modules["own_parts"]
    assert main(["evaluate", str(run)]) == 2
    refusal = capsys.readouterr().err
    assert "which is not one of CarRL's own; if you trust that module, add --trust own_parts\n" in refusal
    assert "own_parts" not in sys.modules
    assert main(["evaluate", str(run), "--trust", flag, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["tracks"][0]["track"] == "polar"


def test_every_verb_that_builds_from_a_runs_folder_asks_for_trust(run, capsys):
    for verb in (["report", "--best-lap", run], ["drive", "--run", run], ["train", f"resume={run}"]):
        assert main([str(each) for each in verb]) == 2
        assert "add --trust own_parts" in capsys.readouterr().err
    assert main(["report", str(run)]) == 0
    trust = ["--trust", str(EXAMPLE / "own_parts.py")]
    assert main(["train", f"resume={run}", *trust, "trainer.frames=120"]) == 0
    assert json.loads((run / "summary.json").read_text())["frames"] == 120


def test_what_a_trusted_module_has_only_imported_is_not_trusted_with_it(run, capsys):
    config = run / ".hydra" / "config.yaml"
    config.write_text(config.read_text().replace("own_parts.read_polar", "own_parts.np.loadtxt"))
    assert main(["evaluate", str(run), "--trust", str(EXAMPLE / "own_parts.py")]) == 2
    assert "track._target_ is 'own_parts.np.loadtxt', which its module has only imported" in capsys.readouterr().err


def test_python_goes_through_the_same_door(road, tmp_path, monkeypatch):
    monkeypatch.chdir(EXAMPLE)
    options = {"compile": False, "evaluation": {"interval": 120}, "replay_buffer": {"batch_size": 32}}
    run = carrl.train(
        "own",
        config_dir="conf",
        track="polar",
        overrides={"track.path": str(road), "trainer.frames": 240},
        folder=tmp_path / "python",
        **options,
    )
    assert run.summary["trust"] == ["own_parts"]
    assert run.config["vehicle"]["_target_"] == "own_parts.HeavyCar"
    assert run.policy(np.zeros(8)).shape == ()
    assert run.policy(np.zeros((3, 8))).shape == (3,)
    with pytest.raises(ConfigError, match="add --trust own_parts"):
        carrl.Run.load(run.folder)
    again = carrl.Run.load(run.folder, trust=["own_parts"])
    assert again.evaluate()["tracks"][0]["drives"] == run.evaluate()["tracks"][0]["drives"]


def test_a_viewer_is_a_few_lines_that_read_the_log(run, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["viewer.py", str(run / "train.mcap")])
    capsys.readouterr()
    runpy.run_path(str(EXAMPLE / "viewer.py"))
    length = int((carrl.log.load(run / "train.mcap")["episode"] == 0).sum())
    assert len(capsys.readouterr().out.splitlines()) == length


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("nowhere.Term", "cannot be imported: ModuleNotFoundError: No module named 'nowhere'"),
        ("math.nothing", "cannot be imported: AttributeError: module 'math' has no attribute 'nothing'"),
        ("math.pi", "is 'math.pi', which is no class or function"),
        ("carrl.sim.sensor.Sensor", "is 'carrl.sim.sensor.Sensor'; it must be carrl.task.reward.Collision or"),
    ],
)
def test_a_target_that_cannot_be_is_one_sentence(target, says, capsys):
    assert main(["train", f"+reward.own._target_={target}", *SHORT]) == 2
    printed = capsys.readouterr().err
    assert "carrl: reward.own._target_ " in printed
    assert says in printed
    assert printed.count("\n") == 1


def test_the_file_that_is_trusted_is_the_one_that_is_imported(run, tmp_path, monkeypatch, capsys):
    (tmp_path / "own_parts.py").write_text("raise RuntimeError('another module of this name')")
    monkeypatch.chdir(tmp_path)
    sys.modules.pop("own_parts", None)
    assert main(["evaluate", str(run), "--trust", str(EXAMPLE / "own_parts.py")]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(run), "--trust", "own_parts.py"]) == 2
    assert "is imported already from" in capsys.readouterr().err
    assert main(["evaluate", str(run), "--trust", "nothing.py"]) == 2
    assert "is no file" in capsys.readouterr().err
