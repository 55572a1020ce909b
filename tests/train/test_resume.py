"""A run that is stopped and resumed, against the same run never stopped."""

import shutil

import pytest
import yaml

from carrl.cli.main import main
from carrl.cli.text.console import ProgressDisplay
from carrl.log import load
from carrl.train.checkpoint import save_checkpoint
from tests.stopped_runs import (
    EAGER,
    FRAMES,
    MOMENTS,
    TINY,
    assert_same_run,
    assert_same_state,
    interrupted,
    rows,
    state_of,
    stop_at,
    train,
)


@pytest.fixture(scope="module")
def never_stopped(tmp_path_factory):
    return train(tmp_path_factory.mktemp("never stopped"), *TINY)


@pytest.mark.parametrize("frames", MOMENTS.values(), ids=MOMENTS.keys())
def test_a_resumed_run_is_the_run_never_stopped_bit_for_bit(frames, never_stopped, tmp_path, monkeypatch):
    run = interrupted(monkeypatch, tmp_path / "run", frames, *TINY)
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, never_stopped)
    assert_same_state(state_of(run), state_of(never_stopped))


def test_a_resumed_run_with_eager_updates_is_the_run_never_stopped_bit_for_bit(tmp_path, monkeypatch):
    """Stopped before the first update and between two copies of the network."""
    whole = train(tmp_path / "whole", *EAGER)
    before, between = MOMENTS["before the first update"], MOMENTS["between two copies of the network"]
    run = interrupted(monkeypatch, tmp_path / "stopped", before, *EAGER)
    with monkeypatch.context() as patches:
        stop_at(patches, between)
        assert main(["train", f"resume={run}"]) == 130
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, whole)
    assert_same_state(state_of(run), state_of(whole))


@pytest.mark.parametrize(
    "overrides",
    [
        ["trainer.seeds=[3,7]"],
        ["sensor.noise=0.2", "start.mirrored=true", "observation=rays_and_last_action"],
        ["collector.steps_per_batch=3", "trainer.frames_per_update=1"],
        ["recorder.max_file_bytes=1048576", "recorder.every_nth_episode=2"],
        ["returns.steps=3", "collector.steps_per_batch=3"],
        ["replay_buffer=prioritized"],
        ["network=noisy", "compile=false", "exploration=constant", "exploration.epsilon=0", "trainer.seeds=[3,7]"],
        ["loss=distributional", "compile=false", "target_updater=soft"],
        ["learning_rate=cosine", "learning_rate.updates=100", "gradient_clipping.max_norm=10", "exploration=linear"],
        ["loss=dueling", "compile=false", "reward=shaped"],
        ["env.cars_per_world=3", "opponents=line", "observation=traffic", "reward=traffic", "trainer.seeds=[3,7]"],
        ["env.cars_per_world=3", "opponents=rule", "sensor.noise=0.2", "start.anywhere=true"],
        ["env.cars_per_world=2", "observation=traffic", "reward=traffic"],
    ],
    ids=" ".join,
)
def test_whatever_draws_random_numbers_goes_on_where_it_was(overrides, tmp_path, monkeypatch):
    shared = [each for each in TINY if "target_updater=soft" not in overrides or "target_updater" not in each]
    whole = train(tmp_path / "whole", *shared, *overrides)
    run = interrupted(monkeypatch, tmp_path / "run", 120, *shared, *overrides)
    assert main(["train", f"resume={run}"]) == 0
    for summary in run.rglob("summary.json"):
        assert_same_run(summary.parent, whole / summary.parent.relative_to(run))
    assert_same_state(state_of(run), state_of(whole))


def test_a_run_may_be_stopped_many_times(never_stopped, tmp_path, monkeypatch):
    run = interrupted(monkeypatch, tmp_path / "run", 40, *TINY)
    for frames in (80, 120, 160):
        with monkeypatch.context() as patches:
            stop_at(patches, frames)
            assert main(["train", f"resume={run}"]) == 130
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, never_stopped)


def test_a_finished_run_can_be_extended(never_stopped, tmp_path):
    run = train(tmp_path / "run", *TINY, "trainer.frames=120")
    assert main(["train", f"resume={run}", f"trainer.frames={FRAMES}"]) == 0
    assert_same_run(run, never_stopped)
    assert yaml.safe_load((run / ".hydra" / "config.yaml").read_text())["trainer"]["frames"] == FRAMES


def test_resuming_a_finished_run_changes_nothing(tmp_path):
    run = train(tmp_path / "run", *TINY, "trainer.frames=40")
    before = tmp_path / "before"
    shutil.copytree(run, before)
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, before)


def test_learning_from_a_log_is_resumed_bit_for_bit(never_stopped, tmp_path, monkeypatch):
    overrides = ["data=log", f"data.path={never_stopped / 'train.mcap'}", "data.updates=300"]
    overrides += ["replay_buffer.batch_size=32", "loss=cql", "track=oval"]
    whole = train(tmp_path / "whole", *overrides)
    run = tmp_path / "run"
    with monkeypatch.context() as patches:
        patches.setattr(ProgressDisplay, "on_round", lambda display, trainer: trainer.stop())
        assert main(["train", *overrides, f"hydra.run.dir={run}"]) == 130
    assert main(["train", f"resume={run}"]) == 0
    assert (run / "checkpoints" / "last.pt").read_bytes() == (whole / "checkpoints" / "last.pt").read_bytes()
    assert rows(run / "metrics.csv") == rows(whole / "metrics.csv")
    assert_same_state(state_of(run), state_of(whole))


def test_what_was_logged_after_the_state_is_cut_off(never_stopped, tmp_path, monkeypatch):
    """As after kill -9: the log and the tables are further than the checkpoint."""
    run = interrupted(monkeypatch, tmp_path / "run", 80, *TINY)
    early = {name: (run / "checkpoints" / name).read_bytes() for name in ("state.pt", "last.pt")}
    with monkeypatch.context() as patches:
        stop_at(patches, 160)
        assert main(["train", f"resume={run}"]) == 130
    for name, content in early.items():
        (run / "checkpoints" / name).write_bytes(content)
    (run / "train.mcap").write_bytes((run / "train.mcap").read_bytes()[:-100])
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, never_stopped)


def test_a_damaged_checkpoint_is_replaced_by_the_one_before(never_stopped, tmp_path, monkeypatch, caplog):
    run = interrupted(monkeypatch, tmp_path / "run", 120, *TINY)
    state = run / "checkpoints" / "state.pt"
    content = bytearray(state.read_bytes())
    middle = len(content) // 2
    for place in range(middle, middle + 100):  # more than torch fills up with between two tensors
        content[place] ^= 1
    state.write_bytes(content)
    assert main(["train", f"resume={run}"]) == 0
    assert "is damaged; the run is resumed from" in caplog.text
    assert_same_run(run, never_stopped)


def test_a_log_that_is_not_as_it_was_is_left_alone(tmp_path, monkeypatch, caplog):
    run = interrupted(monkeypatch, tmp_path / "run", 120, *TINY)
    damaged = b"my notes"
    (run / "train.mcap").write_bytes(damaged)
    assert main(["train", f"resume={run}"]) == 0
    assert (run / "train.mcap").read_bytes() == damaged
    assert len(load(run / "train-1.mcap")) == FRAMES - 120
    assert "It goes on in" in caplog.text


def test_a_killed_writers_left_overs_are_removed(tmp_path, monkeypatch):
    run = interrupted(monkeypatch, tmp_path / "run", 40, *TINY, "trainer.frames=80", "trainer.seeds=[3]")
    for place in ("checkpoints", ".hydra", "seed=3", "seed=3/checkpoints", "seed=3/.hydra"):
        (run / place / ".0123.partial").write_bytes(b"half a file")
    assert main(["train", f"resume={run}"]) == 0
    assert list(run.rglob("*.partial")) == []


@pytest.fixture(scope="module")
def stopped_once(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patches:
        return interrupted(patches, tmp_path_factory.mktemp("stopped") / "run", 56, *TINY, "trainer.seeds=[3,7]")


@pytest.fixture
def stopped(stopped_once, tmp_path):
    """A copy of an interrupted run of two replicates."""
    return shutil.copytree(stopped_once, tmp_path / "run")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["loss=dqn"], "loss=dqn cannot be given with resume="),
        (["seed=4"], "seed=4 cannot be given with resume="),
        (["trainer.frames=1,2"], "trainer.frames=1,2 cannot be given"),
        (["-m"], "--multirun cannot be given with resume="),
        (["trainer.frames=many"], "trainer.frames is 'many'; it must be of type int"),
        (["data.updates=3"], "has no data.updates to be changed"),
        (["hydra.run.dir=elsewhere"], "hydra.run.dir=elsewhere cannot be given"),
        (["trainer.frames="], "trainer.frames is ''"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_a_resumed_run_cannot_change_is_refused(overrides, message, stopped, capsys):
    before = (stopped / ".hydra" / "config.yaml").read_text()
    assert main(["train", f"resume={stopped}", *overrides]) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert output.err.count("\n") == 1
    assert (stopped / ".hydra" / "config.yaml").read_text() == before


def test_one_of_several_agents_cannot_be_resumed_alone(stopped, capsys):
    assert main(["train", f"resume={stopped / 'seed=3'}"]) == 2
    assert f"resume them together: resume={stopped}" in capsys.readouterr().err


def test_a_run_whose_configuration_was_changed_is_refused(stopped, capsys):
    config = stopped / ".hydra" / "config.yaml"
    config.write_text(config.read_text().replace("gamma: 0.95", "gamma: 0.9"))
    assert main(["train", f"resume={stopped}"]) == 2
    assert "differs from the checkpoint's in loss.gamma" in capsys.readouterr().err


@pytest.mark.parametrize("break_it", ["cursor", "actions", "cars", "network", "folders", "log", "missing"])
def test_a_state_that_no_such_run_can_have_is_refused(break_it, stopped, capsys):
    path = stopped / "checkpoints" / "state.pt"
    state = state_of(stopped)
    if break_it == "cursor":
        state["replay_buffer"]["cursor"] = 10**9
    elif break_it == "actions":
        state["replay_buffer"]["fields"]["action"][:] = 10**9
    elif break_it == "cars":
        state["cars"]["next_gate"][:] = 10**9
    elif break_it == "network":
        state["algorithm"]["replicates"][0]["loss"] = {}
    elif break_it == "folders":
        del state["folders"]
    elif break_it == "log":
        state["folders"][0]["log"] = {"part": "elsewhere"}
    else:
        del state["tracker"]
    save_checkpoint(path, state)
    assert main(["train", f"resume={stopped}"]) == 2
    assert "the state does not fit the run's configuration" in capsys.readouterr().err


def test_a_run_broken_off_before_its_first_checkpoint_begins_anew(never_stopped, tmp_path, monkeypatch):
    run = interrupted(monkeypatch, tmp_path / "run", 0, *TINY)
    shutil.rmtree(run / "checkpoints")
    (run / "summary.json").unlink()
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, never_stopped)


def test_a_run_killed_while_its_first_checkpoint_was_written_begins_anew(never_stopped, tmp_path, monkeypatch):
    run = interrupted(monkeypatch, tmp_path / "run", 0, *TINY)
    (run / "summary.json").unlink()
    for checkpoint in (run / "checkpoints").iterdir():
        checkpoint.unlink()
    (run / "checkpoints" / ".0123.partial").write_bytes(b"half a checkpoint")
    assert main(["train", f"resume={run}"]) == 0
    assert_same_run(run, never_stopped)


@pytest.mark.parametrize("left", ["summary.json", "checkpoints/best.pt"])
def test_a_run_whose_state_was_deleted_is_refused(left, stopped, capsys):
    shutil.rmtree(stopped / "checkpoints")
    (stopped / "checkpoints").mkdir()
    (stopped / left).write_text("{}")
    assert main(["train", f"resume={stopped}"]) == 2
    assert "its checkpoints/state.pt was deleted or moved" in capsys.readouterr().err


def test_agents_that_ended_at_different_times_cannot_get_more_episodes(tmp_path, capsys):
    limits = ["env.max_steps=40", "trainer.episodes=8", "trainer.frames=100000", "trainer.frames_per_update=8"]
    overrides = [*TINY, "env.num_envs=1", "trainer.seeds=[0,1]", *limits]
    run = train(tmp_path / "run", *overrides)
    before = (run / ".hydra" / "config.yaml").read_text()
    assert main(["train", f"resume={run}", "trainer.episodes=9"]) == 2
    assert "replicates that ended before the others" in capsys.readouterr().err
    assert (run / ".hydra" / "config.yaml").read_text() == before


def test_nothing_to_resume_is_refused(tmp_path, capsys):
    assert main(["train", f"resume={tmp_path / 'nothing'}"]) == 2
    assert "is not a folder" in capsys.readouterr().err
