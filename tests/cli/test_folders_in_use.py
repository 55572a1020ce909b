"""What runs, resumes, sweeps and studies do to a folder that has a run already, or in which another process works."""

import json
import os
import shutil
from datetime import datetime

import hydra.core.utils
import pytest

from carrl.cli.main import main
from carrl.train.new_folder import LOCK, locked
from carrl.train.sweep import SweepFolder

TINY = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=16", "replay_buffer.batch_size=16"]
SETTINGS = [".hydra/config.yaml", ".hydra/hydra.yaml", ".hydra/overrides.yaml"]


def train(folder, *overrides):
    return main(["train", *TINY, *overrides, f"hydra.run.dir={folder}"])


def sweep(folder, *overrides):
    return main(["train", "-m", *TINY, *overrides, f"hydra.sweep.dir={folder}"])


def contents(folder):
    """The bytes of all files below a folder, by name."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    assert train(folder, "seed=1") == 0
    return folder


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweeps") / "sweep"
    assert sweep(folder, "seed=1,2") == 0
    return folder


@pytest.fixture
def one_moment(monkeypatch, tmp_path):
    """All runs begin in the same second, and in one folder."""

    class Now(datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 31, 12, 0, 0)

    monkeypatch.setattr(hydra.core.utils, "datetime", Now)
    monkeypatch.setattr("carrl.cli.tune.datetime", Now)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "outputs"


def test_a_run_leaves_no_lock_and_hydras_records(run):
    assert set(SETTINGS) <= contents(run).keys()
    assert LOCK not in contents(run)
    assert "seed=1" in (run / ".hydra" / "overrides.yaml").read_text()
    assert f"output_dir: {run}" in (run / ".hydra" / "hydra.yaml").read_text()


def test_a_second_run_into_a_folder_is_refused_and_changes_nothing(run, capsys):
    before = contents(run)
    assert train(run, "seed=9") == 2
    message = capsys.readouterr().err
    assert f"carrl: '{run}' has a run already, whose summary.json would be overwritten" in message
    assert f"carrl train resume={run}" in message
    assert contents(run) == before


@pytest.mark.parametrize(
    "left",
    [
        "summary.json",
        "train.mcap",
        "train-1.mcap",
        "metrics.csv",
        "evaluations.csv",
        "checkpoints/state.pt",
        "checkpoints/state-previous.pt",
        "checkpoints/best.pt",
        "lap.png",
        ".hydra/config.yaml",
        "seed=3/summary.json",
        "seed=3/train.mcap",
    ],
)
def test_whatever_a_run_has_left_is_not_overwritten(left, tmp_path, capsys):
    (tmp_path / left).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / left).write_text("work")
    assert train(tmp_path) == 2
    message = capsys.readouterr().err
    assert f"whose {left} would be overwritten" in message
    assert ("resume=" in message) == (left == ".hydra/config.yaml")  # nothing else can be resumed here
    assert contents(tmp_path) == {left: b"work"}


@pytest.mark.parametrize("name", ["train.mcap", "metrics.csv", "checkpoints", "lap.png", "summary.json"])
@pytest.mark.parametrize("kind", ["folder", "dangling link"])
def test_a_folder_or_a_dangling_link_by_the_name_of_a_runs_file_is_one_sentence(kind, name, tmp_path, capsys):
    path = tmp_path / "run" / name
    path.parent.mkdir()
    path.mkdir() if kind == "folder" else path.symlink_to(tmp_path / "nowhere")
    refused = (kind, name) != ("folder", "checkpoints")  # an empty one harms nobody
    assert train(tmp_path / "run") == (2 if refused else 0)
    if refused:
        assert f"{name} would be overwritten" in capsys.readouterr().err
        assert os.listdir(tmp_path / "run") == [name]
        assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("kind", ["folder", "dangling link"])
@pytest.mark.parametrize("name", ["hydra.yaml", "overrides.yaml"])
def test_a_folder_or_a_dangling_link_among_a_resumed_runs_settings_is_one_sentence(name, kind, run, tmp_path, capsys):
    path = shutil.copytree(run, tmp_path / "run") / ".hydra" / name
    path.unlink(missing_ok=True)
    path.mkdir() if kind == "folder" else path.symlink_to(tmp_path / "nowhere")
    assert main(["train", f"resume={tmp_path / 'run'}", "trainer.frames=32"]) == 2
    assert f"'{path}'" in capsys.readouterr().err
    assert not (tmp_path / "nowhere").exists()


def test_a_folder_by_the_name_of_a_left_over_stays(run, tmp_path):
    folder = shutil.copytree(run, tmp_path / "run")
    mine = [folder / "checkpoints" / ".mine.partial", folder / ".mine.partial"]
    for each in mine:
        each.mkdir()
    assert main(["train", f"resume={folder}", "trainer.frames=32"]) == 0
    assert all(each.is_dir() for each in mine)


def test_several_seeds_do_not_replace_those_of_another_run(swept, capsys):
    before = contents(swept)
    assert train(swept, "trainer.seeds=[1,2]") == 2
    assert "whose seed=1/summary.json would be overwritten; choose another folder" in capsys.readouterr().err
    assert contents(swept) == before


def test_a_refused_run_leaves_no_folder(tmp_path, capsys):
    assert train(tmp_path / "run", "vehicle.speed=-3") == 2
    assert "vehicle.speed is -3" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["checkpoints", "seed=7", "a/b"])
def test_nothing_begins_in_the_folder_of_a_run(place, run, tmp_path, capsys):
    folder = shutil.copytree(run, tmp_path / "run")
    before = contents(folder)
    for begin in (train, sweep):
        assert begin(folder / place) == 2
        assert f"'{folder / place}' lies in the folder of the run '{folder}'; choose" in capsys.readouterr().err
    assert contents(folder) == before


def test_a_run_begins_below_a_sweep_or_what_another_program_left(swept, tmp_path):
    folder = shutil.copytree(swept, tmp_path / "sweep")
    (folder / ".hydra").mkdir()
    (folder / ".hydra" / "config.yaml").write_text("db: mysql\n")
    assert train(folder / "seed=3") == 0


def test_runs_of_the_same_second_get_a_folder_each(one_moment):
    for seed in (1, 2, 3):
        assert main(["train", *TINY, f"seed={seed}"]) == 0
    day = one_moment / "2026-01-31"
    seeds = {path.name: json.loads((path / "summary.json").read_text())["seed"] for path in day.iterdir()}
    assert seeds == {"12-00-00": 1, "12-00-00-2": 2, "12-00-00-3": 3}


def test_sweeps_of_the_same_second_get_a_folder_each(one_moment):
    for seed in (1, 2):
        assert main(["train", "-m", *TINY, f"seed={seed}"]) == 0
    day = one_moment / "multirun" / "2026-01-31"
    assert sorted(path.name for path in day.iterdir()) == ["12-00-00", "12-00-00-2"]
    for name, seed in (("12-00-00", 1), ("12-00-00-2", 2)):
        [note] = SweepFolder(day / name).notes().values()
        assert note.state == "finished"
        assert f"seed={seed}" in note.name
        assert (day / name / "multirun.yaml").exists()


@pytest.mark.parametrize("command", [["resume={}"], ["hydra.run.dir={}"], ["-m", "hydra.sweep.dir={}"]])
def test_a_folder_in_which_another_process_works_is_refused_and_unchanged(command, run, capsys):
    arguments = [each.format(run) for each in command]
    fresh = [] if arguments[0].startswith("resume") else TINY
    before = contents(run)
    with locked(run):
        assert main(["train", *arguments, *fresh]) == 2
    assert f"carrl: '{run}' is in use by process {os.getpid()}; wait until it has ended" in capsys.readouterr().err
    assert contents(run) == before


def test_a_job_whose_run_is_in_use_fails_and_the_others_go_on(swept, capsys):
    with locked(swept / "seed=1"):
        assert sweep(swept, "seed=1,2") == 2
    assert f"'{swept / 'seed=1'}' is in use by process {os.getpid()}" in capsys.readouterr().err
    assert [note.state for note in SweepFolder(swept).notes().values()] == ["failed", "finished before"]


def test_a_sweep_of_something_else_leaves_the_runs_of_another_as_they_are(swept, capsys):
    before = contents(swept / "seed=1")
    before.pop("job.json")
    assert sweep(swept, "seed=1,2", "network.hidden_sizes=[4]") == 2
    assert "differs from the checkpoint's in network.hidden_sizes" in capsys.readouterr().err
    after = contents(swept / "seed=1")
    assert json.loads(after.pop("job.json"))["state"] == "failed"
    assert after == before


def test_a_sweep_does_not_train_anew_what_lost_its_state(tmp_path, capsys):
    assert sweep(tmp_path, "seed=1") == 0
    (job,) = (path for path in tmp_path.iterdir() if path.is_dir())
    for name in ("state.pt", "state-previous.pt"):
        (job / "checkpoints" / name).unlink(missing_ok=True)
    log = (job / "train.mcap").read_bytes()
    assert sweep(tmp_path, "seed=1") == 2
    assert "checkpoints/state.pt" in capsys.readouterr().err
    assert (job / "train.mcap").read_bytes() == log


def test_a_sweep_keeps_files_by_its_notes_names_that_it_did_not_write(tmp_path):
    inner = tmp_path / "older"
    others = {"job.json": "{}", "mine/job.json": '{"number": 1}', "mine/stop": "at the lights", "older/stop": ""}
    inner.mkdir()
    (tmp_path / "mine").mkdir()
    for name, text in others.items():
        (tmp_path / name).write_text(text)
    assert sweep(inner / "sweep", "seed=1,2") == 0  # whose notes are another sweep's
    notes = {path.name: (path / "job.json").read_bytes() for path in (inner / "sweep").glob("seed=*")}
    assert len(notes) == 2
    assert sweep(tmp_path, "seed=1,2") == 0
    assert {name: (tmp_path / name).read_text() for name in others} == others
    assert {path.name: (path / "job.json").read_bytes() for path in (inner / "sweep").glob("seed=*")} == notes
    assert [note.name for note in SweepFolder(tmp_path).notes().values()] == ["seed=1", "seed=2"]


def test_a_strangers_note_in_a_jobs_folder_ends_the_sweep_in_a_sentence(tmp_path, capsys):
    (tmp_path / "seed=1").mkdir()
    (tmp_path / "seed=1" / "job.json").write_text("[1, 2]")
    assert sweep(tmp_path, "seed=1,2") == 2
    assert "job.json' is in the way of a sweep's note" in capsys.readouterr().err
    assert (tmp_path / "seed=1" / "job.json").read_text() == "[1, 2]"


@pytest.mark.parametrize("kind", ["folder", "file", "empty file", "dangling link"])
def test_something_by_the_name_of_the_wish_to_end_is_left_alone(kind, tmp_path, capsys):
    stop = tmp_path / "stop"
    if kind == "folder":
        stop.mkdir()
    elif kind == "dangling link":
        stop.symlink_to(tmp_path / "nowhere")
    else:
        stop.write_text("" if kind == "empty file" else "mine")
    assert sweep(tmp_path, "seed=1,2") == 2
    assert f"'{stop}' would end the sweep" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["stop"]


def test_a_sweeps_own_wish_to_end_is_forgotten_when_it_goes_on(tmp_path):
    folder = SweepFolder(tmp_path)
    folder.stop()
    assert folder.is_to_stop
    folder.begin()
    assert not folder.is_to_stop
