"""Sweeps as typed: their tree, their console, their failures, and going on after an end before the time."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from carrl.cli.main import main
from carrl.train.sweep import JobNote, SweepFolder, job_name
from tests.processes import carrl_command

TINY = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=16", "replay_buffer.batch_size=16"]


def sweep(folder, *overrides):
    return main(["train", "-m", *TINY, *overrides, f"hydra.sweep.dir={folder}"])


def folders_of(sweep_folder):
    return sorted(path.name for path in sweep_folder.iterdir() if path.is_dir() and path.name[0] != ".")


def test_a_jobs_folder_is_named_by_what_varies(tmp_path, capsys):
    assert sweep(tmp_path, "loss=dqn,double_dqn", "seed=range(0,2)") == 0
    assert folders_of(tmp_path) == [f"loss={loss},seed={seed}" for loss in ("double_dqn", "dqn") for seed in (0, 1)]
    output = capsys.readouterr()
    assert "4 of 4 jobs" in output.out
    assert "[4/4] loss=double_dqn,seed=1 finished" in output.err


def test_where_nothing_varies_all_overrides_name_the_folder(tmp_path):
    assert main(["train", "-m", "compile=false", "trainer.frames=8", f"hydra.sweep.dir={tmp_path}"]) == 0
    assert folders_of(tmp_path) == ["compile=false,trainer.frames=8"]


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        (["seed=3", "compile=false"], "seed=3"),
        (["track=file", "track.name_or_path='/a/my circuits/Spa.csv'"], "track=file,track=Spa"),
        (["data.path='/runs/one/train.mcap'"], "data=one"),
        (["data.path=['/runs/one/train.mcap','/runs/two/train.mcap']"], "data=one+two"),
        (["network.hidden_sizes=[64,32]"], "network.hidden_sizes=[64,32]"),
        (["a='../../x y'"], "a=x-y"),
    ],
)
def test_names_of_folders_have_no_path_in_them(overrides, name):
    assert job_name(overrides, ["compile"]) == name


def test_jobs_whose_names_would_be_the_same_are_numbered(tmp_path):
    assert sweep(tmp_path, "++recorder.note='a/x','b/x'") == 2  # refused, each in its own folder
    assert folders_of(tmp_path) == ["0", "1"]


def test_a_job_that_fails_is_named_and_the_others_go_on(tmp_path, capsys):
    assert sweep(tmp_path, "vehicle.speed=-3,10") == 2
    output = capsys.readouterr()
    assert "failed: vehicle.speed=-3: vehicle.speed is -3" in output.out
    assert output.err.splitlines()[-1].startswith("carrl: vehicle.speed is -3")
    states = [note.state for note in SweepFolder(tmp_path).notes().values()]
    assert states == ["failed", "finished"]


def test_a_sweep_whose_jobs_are_numbered_tells_of_those_that_fail(tmp_path, capsys):
    numbered = "hydra.sweep.subdir=${hydra.job.num}"
    assert main(["train", "-m", *TINY, numbered, "vehicle.speed=-3,10", f"hydra.sweep.dir={tmp_path}"]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("carrl: vehicle.speed is -3")
    assert [note.state for note in SweepFolder(tmp_path).notes().values()] == ["failed", "finished"]


def test_the_same_sweep_again_trains_only_what_is_not_finished(tmp_path, capsys):
    assert sweep(tmp_path, "seed=0,1") == 0
    (kept, gone) = (tmp_path / f"seed={seed}" / "summary.json" for seed in (0, 1))
    before = kept.read_text()
    gone.unlink()
    assert sweep(tmp_path, "seed=0,1") == 0
    assert [note.state for note in SweepFolder(tmp_path).notes().values()] == ["finished before", "finished"]
    assert kept.read_text() == before
    assert json.loads(gone.read_text())["finished"]


def test_another_sweep_into_the_same_folder_is_refused(tmp_path, capsys):
    assert sweep(tmp_path, "seed=0,1") == 0
    assert sweep(tmp_path, "seed=0,1", "network.hidden_sizes=[4]") == 2
    assert "differs from the checkpoint's in network.hidden_sizes" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGHUP, marks=pytest.mark.exhaustive)])
def test_a_signal_ends_a_sweep_with_the_job_in_hand_saved(number, tmp_path):
    overrides = ["compile=false", "track=oval", "seed=0,1", f"hydra.sweep.dir={tmp_path}"]
    command = [*carrl_command(), "train", "-m", *overrides]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    metrics, deadline = tmp_path / "seed=0" / "metrics.csv", time.monotonic() + 60
    while not (metrics.exists() and metrics.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert f"go on with the same command and hydra.sweep.dir={tmp_path}" in output
    assert [note.state for note in SweepFolder(tmp_path).notes().values()] == ["interrupted"]
    assert (tmp_path / "seed=0" / "checkpoints" / "state.pt").exists()
    assert not (tmp_path / "seed=1").exists() or not (tmp_path / "seed=1" / "summary.json").exists()


def test_a_note_of_another_program_is_passed_over(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "job.json").write_text("[]")
    (tmp_path / "b").mkdir()
    JobNote(0, "b", "running").write(tmp_path / "b")
    assert [note.name for note in SweepFolder(tmp_path).notes().values()] == ["b"]


@pytest.mark.parametrize(
    ("package", "launcher"),
    [
        ("hydra_joblib_launcher", "joblib"),
        pytest.param("hydra_submitit_launcher", "submitit_local", marks=pytest.mark.exhaustive),
    ],
)
@pytest.mark.slow
def test_a_launcher_runs_jobs_in_other_processes(package, launcher, tmp_path):
    if importlib.util.find_spec("hydra_plugins") is None or not importlib.util.find_spec(f"hydra_plugins.{package}"):
        pytest.skip(f"{package} is not installed: pip install 'carrl[sweep]'")
    overrides = [*TINY, f"hydra/launcher={launcher}", "vehicle.speed=10,-3,12", f"hydra.sweep.dir={tmp_path}"]
    workers = ["hydra.launcher.n_jobs=2"] if launcher == "joblib" else []
    command = [sys.executable, "-m", "carrl.cli.main", "train", "-m", *overrides, *workers]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=os.environ)
    assert done.returncode == 2, done.stderr
    assert done.stderr.splitlines()[-1] == "carrl: vehicle.speed is -3; it must be a positive number"
    assert [note.state for note in SweepFolder(tmp_path).notes().values()] == ["finished", "failed", "finished"]


def test_a_launcher_that_is_not_installed_is_named(tmp_path, capsys, monkeypatch):
    assert sweep(tmp_path, "hydra/launcher=jobllib") == 2
    assert "pip install 'carrl[sweep]'" in capsys.readouterr().err
