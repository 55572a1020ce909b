"""What a resumed run refuses or says: settings without effect, links, other inputs, changed tables."""

import os
import shutil

import numpy as np
import pytest
import yaml

from carrl.cli.main import main
from carrl.cli.sweep import _train_or_go_on
from carrl.errors import CheckpointError
from carrl.files import open_itself
from carrl.train.checkpoint import STATE, load_state, save_checkpoint
from carrl.train.files import CONFIG, load_config
from carrl.train.resumption import check_contents, progress_of, resume
from carrl.train.sweep import SweepFolder
from tests.stopped_runs import TINY, interrupted, rows, state_of, train

SHORT = [*TINY, "trainer.frames=160"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs that tests copy: a finished one, one of two replicates that was stopped, and one that learnt from a log."""
    place = tmp_path_factory.mktemp("made")
    finished = train(place / "finished", *SHORT)
    with pytest.MonkeyPatch.context() as patches:
        interrupted(patches, place / "stopped", 80, *SHORT, "trainer.seeds=[3,7]")
    data = ["data=log", f"data.path={finished / 'train.mcap'}", "data.updates=20", "replay_buffer.batch_size=32"]
    train(place / "offline", "track=oval", *data)
    return place


@pytest.fixture
def copy_of(made, tmp_path):
    return lambda name: shutil.copytree(made / name, tmp_path / name)


def files_of(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(capsys, run, *overrides):
    """What is said, in one line, of a run that was refused and left as it was."""
    before = files_of(run)
    capsys.readouterr()
    assert main(["train", f"resume={run}", *overrides]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert files_of(run) == before
    return printed.err


# Settings without effect


@pytest.mark.parametrize(
    "override",
    [
        "trainer.frames=160",
        "trainer.frames=100",
        "trainer.episodes=100000",
        "trainer.checkpoint_interval=5",
        "evaluation.interval=40",
        "optimizer.lr=0.5",
    ],
)
def test_a_setting_has_no_effect_on_a_run_that_is_over(override, copy_of, capsys):
    run = copy_of("finished")
    said = refused(capsys, run, override)
    assert f"{override} would have no effect: run '{run}' has nothing left to learn: it has 160 frames" in said
    assert "give greater limits with it: trainer.frames or trainer.episodes" in said


def test_a_run_that_has_nothing_left_to_learn_says_so(copy_of, capsys):
    assert main(["train", f"resume={copy_of('finished')}"]) == 0
    assert "has nothing left to learn: it has 160 frames (limit 160) and" in capsys.readouterr().out


def test_a_limit_that_is_passed_has_no_effect_on_a_run_that_was_stopped(copy_of, capsys):
    assert "trainer.frames=80 would have no effect" in refused(capsys, copy_of("stopped"), "trainer.frames=80")


@pytest.mark.parametrize(
    "override",
    [
        "trainer.frames=9999",
        "trainer.episodes=9999",
        "evaluation.interval=5",
        "collector.workers=2",
        "collector.address=null",
    ],
)
def test_a_setting_of_the_simulator_has_no_effect_on_a_run_that_learns_from_logs(override, copy_of, capsys):
    said = refused(capsys, copy_of("offline"), override, "data.updates=30")
    assert f"{override.replace('null', 'None')} would have no effect" in said
    assert "learns from logs" in said


@pytest.mark.parametrize("override", ["data.updates=20", "data.updates=5", "optimizer.lr=0.1"])
def test_what_a_run_that_has_learnt_from_logs_cannot_take_up_is_refused(override, copy_of, capsys):
    assert "nothing left to learn: it has 20 updates" in refused(capsys, copy_of("offline"), override)


def test_the_value_that_it_has_already_is_named_and_the_run_goes_on(copy_of):
    resumption = resume(copy_of("stopped"), ["trainer.frames=160", "evaluation.interval=40"])
    assert resumption.remarks == ("trainer.frames is 160 already",)


@pytest.mark.parametrize("plus", ["+", "++"])
def test_an_override_with_a_plus_is_answered_with_the_one_without(plus, copy_of, capsys):
    said = refused(capsys, copy_of("stopped"), f"{plus}optimizer.lr=0.1")
    assert "leave out the +: optimizer.lr=0.1" in said


def test_what_is_given_twice_is_refused(copy_of, capsys):
    run = copy_of("stopped")
    said = refused(capsys, run, "trainer.frames=300", "trainer.frames=400")
    assert "trainer.frames is given more than once" in said
    assert "resume= is given 2 times" in refused(capsys, run, f"resume={run}")


@pytest.mark.parametrize(("final_share", "updates", "is_zero"), [(0.0, 50, True), (0.1, 50, False), (0.0, 5000, False)])
def test_a_learning_rate_that_has_fallen_to_zero_is_known(final_share, updates, is_zero, made):
    state = state_of(made / "stopped")
    config = state["config"] | {"learning_rate": {"final_share": final_share, "updates": updates}}
    state["learner"]["updates"] = 60
    progress = progress_of(config, state)
    assert progress is not None
    assert progress.learning_rate_is_zero == is_zero


# States


@pytest.mark.parametrize("name", ["finished", "stopped"])
def test_a_deleted_state_is_told_from_one_that_never_was(name, copy_of, capsys):
    run = copy_of(name)
    shutil.rmtree(run / "checkpoints")
    assert "has metrics.csv, but its checkpoints/state.pt was deleted or moved" in refused(capsys, run)


def test_a_deleted_state_of_a_run_that_was_killed_does_not_let_it_begin_anew(copy_of, capsys):
    run = copy_of("finished")
    shutil.rmtree(run / "checkpoints")
    (run / "summary.json").unlink()
    assert "has metrics.csv, but its checkpoints/state.pt was deleted or moved" in refused(capsys, run)


def test_a_run_of_a_version_that_kept_no_state_is_told_from_it(copy_of, capsys):
    run = copy_of("finished")
    shutil.rmtree(run / "checkpoints")
    config = yaml.safe_load((run / CONFIG).read_text())
    del config["trainer"]["checkpoint_interval"]
    (run / CONFIG).write_text(yaml.safe_dump(config))
    assert "a version of CarRL that kept no checkpoints/state.pt" in refused(capsys, run)


def test_a_state_of_another_version_is_refused(copy_of, capsys):
    run = copy_of("stopped")
    state = state_of(run)
    del state["state_version"]
    save_checkpoint(run / STATE, state)
    assert "its state has the version 1, this CarRL goes on from 3" in refused(capsys, run)


# Links and what is no file


@pytest.mark.parametrize(
    "name",
    [
        "checkpoints",
        "checkpoints/state.pt",
        ".hydra",
        ".hydra/config.yaml",
        "seed=3",
        "seed=7/train.mcap",
        "seed=7/metrics.csv",
        "seed=3/checkpoints",
        "seed=3/.hydra/config.yaml",
    ],
)
def test_nothing_is_written_through_a_link(name, copy_of, tmp_path, capsys):
    run, elsewhere = copy_of("stopped"), tmp_path / "elsewhere"
    (run / name).rename(elsewhere)
    (run / name).symlink_to(elsewhere)
    before = files_of(tmp_path)
    assert f"'{run / name}' is a symbolic link to '{elsewhere}'" in refused(capsys, run)
    assert files_of(tmp_path) == before


@pytest.mark.parametrize("name", ["seed=3/train-1.mcap", "seed=3/lap.png", "summary.json", "wandb"])
def test_a_link_to_nothing_is_refused(name, copy_of, tmp_path, capsys):
    run = copy_of("stopped")
    (run / name).symlink_to(tmp_path / "nothing")
    assert "is a symbolic link" in refused(capsys, run)
    assert not (tmp_path / "nothing").exists()


@pytest.mark.parametrize(
    "name",
    ["summary.json", "seed=3/summary.json", "seed=7/lap.png", "learning_curve.png", "seed=3/checkpoints/best.pt"],
)
def test_a_folder_in_the_place_of_a_runs_file_is_refused_at_once(name, copy_of, capsys):
    run = copy_of("stopped")
    (run / name).unlink(missing_ok=True)
    (run / name).mkdir()
    said = f"'{run / name}' is a folder, but the run writes a file there; move it away, and it is resumed"
    assert said in refused(capsys, run)


def test_the_links_that_a_logger_keeps_within_its_folder_are_left_to_it(tmp_path):
    (tmp_path / "run" / "wandb" / "offline-run-1").mkdir(parents=True)
    link = tmp_path / "run" / "wandb" / "latest-run"
    link.symlink_to("offline-run-1")
    check_contents(tmp_path / "run")
    link.unlink()
    link.symlink_to(tmp_path)
    with pytest.raises(CheckpointError, match="is a symbolic link"):
        check_contents(tmp_path / "run")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize("name", [".hydra/hydra.yaml", "seed=3/metrics.csv", "seed=3/train.mcap", "checkpoints/x"])
def test_a_pipe_among_a_runs_files_is_refused_at_once(name, copy_of, capsys):
    run = copy_of("stopped")
    (run / name).unlink(missing_ok=True)
    os.mkfifo(run / name)
    capsys.readouterr()
    assert main(["train", f"resume={run}"]) == 2
    assert f"'{run / name}' is neither a file nor a folder" in capsys.readouterr().err


def test_a_file_is_opened_itself_or_not_at_all(tmp_path):
    (tmp_path / "file").write_text("as it was")
    (tmp_path / "link").symlink_to("file")
    with pytest.raises(OSError, match="it is a symbolic link"), open(tmp_path / "link", "w", opener=open_itself):
        pass
    assert (tmp_path / "file").read_text() == "as it was"
    with open(tmp_path / "file", opener=open_itself) as file:
        assert file.read() == "as it was"


# Tables


@pytest.mark.parametrize("left", [None, 0, 0.5])
@pytest.mark.parametrize("name", ["metrics.csv", "evaluations.csv"])
def test_a_table_that_was_deleted_or_cut_off_is_written_anew(name, left, copy_of, caplog):
    run = copy_of("finished")
    content = (run / name).read_bytes()
    (run / name).unlink()
    if left is not None:
        (run / name).write_bytes(content[: int(left * len(content))])
    before = rows_of(content, run / "other.csv")
    assert main(["train", f"resume={run}", "trainer.frames=200"]) == 0
    assert rows(run / name)[: len(before)] == before
    assert f"{name}' " in caplog.text
    assert "lines, which the checkpoint puts back" in caplog.text


def rows_of(content, path):
    """The rows of a table, but for the one of the drive at the end of a run, which a longer run does not have."""
    path.write_bytes(content)
    return rows(path)[:-1]


def test_a_table_that_somebody_changed_is_left_alone(copy_of, capsys):
    run = copy_of("finished")
    table = (run / "metrics.csv").read_bytes()
    (run / "metrics.csv").write_bytes(table.replace(b"collision", b"my notes!", 1))
    assert "metrics.csv': line 2 is not as the run wrote it" in refused(capsys, run, "trainer.frames=200")


# Tracks and logs


def ring(width):
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    points = [f"{40 * np.cos(a):.3f},{40 * np.sin(a):.3f},{width},{width}" for a in angle]
    return "\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *points, ""])


def without_track(overrides):
    return [each for each in overrides if not each.startswith("track=")]


def test_another_version_of_a_track_file_is_refused_by_name(tmp_path, monkeypatch, capsys):
    file = tmp_path / "ring.csv"
    file.write_text(ring(4))
    run = interrupted(monkeypatch, tmp_path / "run", 80, *without_track(SHORT), f"track={file}")
    file.write_text(ring(5))
    assert "other inputs: track 'ring.csv' was changed; put back" in refused(capsys, run)
    file.write_text(ring("4.00"))  # the same road
    assert main(["train", f"resume={run}"]) == 0
    config = load_config(run)
    assert _train_or_go_on(config, run, SweepFolder(tmp_path)) == "finished before"
    file.write_text(ring(5))
    with pytest.raises(CheckpointError, match=r"track 'ring\.csv' was changed"):  # in a sweep, too
        _train_or_go_on(config, run, SweepFolder(tmp_path))


def test_a_circuit_more_or_less_in_a_folder_is_refused_by_name(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "circuits"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.csv").write_text(ring(4))
    many = ["track=circuits", "track.count=0", "track.validation=1", f"track.folder={folder}"]
    run = interrupted(monkeypatch, tmp_path / "run", 80, *without_track(SHORT), *many)
    (folder / "a.csv").rename(folder / "c.csv")
    assert "track 'a.csv' is missing, track 'c.csv' is new" in refused(capsys, run)


def test_another_log_to_learn_from_is_refused_by_name(copy_of, made, tmp_path, capsys):
    log, run = made / "finished" / "train.mcap", copy_of("offline")
    other = train(tmp_path / "other", *SHORT, "seed=1") / "train.mcap"
    content = log.read_bytes()
    try:
        log.write_bytes(other.read_bytes())
        assert f"log '{log}' was changed" in refused(capsys, run, "data.updates=30")
    finally:
        log.write_bytes(content)


@pytest.fixture
def without_compiler(monkeypatch):
    monkeypatch.setenv("CXX", "/nowhere/g++")


def test_the_state_says_how_updates_were_made(made, tmp_path, without_compiler):
    assert load_state(made / "finished")["learner"]["kind"] == "machine code"
    assert load_state(train(tmp_path / "eager", *SHORT, "compile=false"))["learner"]["kind"] == "eager"
    fallen_back = train(tmp_path / "run", *SHORT, "loss=dueling")
    assert load_state(fallen_back)["learner"]["kind"] == "eager"


def test_a_run_that_goes_on_with_the_other_kind_of_update_says_so(tmp_path, monkeypatch, without_compiler, caplog):
    run = interrupted(monkeypatch, tmp_path / "run", 120, *SHORT, "loss=dueling")
    state = state_of(run)
    state["learner"]["kind"] = "compiled"  # as on a machine with a compiler
    save_checkpoint(run / STATE, state)
    caplog.clear()
    assert main(["train", f"resume={run}"]) == 0
    assert "The updates so far were compiled, those from here on are eager" in caplog.text
    caplog.clear()
    assert main(["train", f"resume={run}", "trainer.frames=200"]) == 0
    assert "The updates so far were" not in caplog.text
