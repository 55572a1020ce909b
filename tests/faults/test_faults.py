"""Faults that are caused for real: each ends in one sentence, a run that can be resumed and a log that can be read."""

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from carrl.cli.main import main
from carrl.log import load, verify
from tests.processes import carrl_command

FRAMES = 1600
OVERRIDES = [
    "track=oval",
    "compile=false",
    "env.num_envs=8",
    f"trainer.frames={FRAMES}",
    "trainer.frames_per_update=8",
    "trainer.checkpoint_interval=0.2",
    "evaluation.interval=500",
]
CARRL = [sys.executable, "-m", "carrl.cli.main"]


def start(folder, *overrides, prelude="pass", **options):
    """A run in a process of its own, which runs the prelude first."""
    command = [*carrl_command(prelude), "train", *OVERRIDES, f"hydra.run.dir={folder}", *overrides]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def wait_for(process, condition):
    """Waits until something holds, while the process goes on."""
    deadline = time.monotonic() + 60
    while not condition():
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()
        time.sleep(0.02)


def has_checkpoints(folder):
    return lambda: (folder / "checkpoints" / "state-previous.pt").exists() and (folder / "metrics.csv").exists()


def last_words(process):
    """What the run said at its end, and that it ended by itself, as after a user's mistake."""
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2, errors
    *_, sentence = errors.strip().splitlines()
    assert sentence.startswith("carrl: ")
    return sentence


@pytest.fixture(scope="module")
def never_stopped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("never stopped")
    assert main(["train", *OVERRIDES, f"hydra.run.dir={folder}"]) == 0
    return folder


def assert_resumes(run, never_stopped):
    """Whether the resumed run ends as the one never stopped."""
    verify(run / "train.mcap")
    assert main(["train", f"resume={run}"]) == 0
    assert (run / "checkpoints" / "last.pt").read_bytes() == (never_stopped / "checkpoints" / "last.pt").read_bytes()
    assert (load(run / "train.mcap") == load(never_stopped / "train.mcap")).all()


def in_namespace(script, tmp_path):
    """Runs a shell script that may mount file systems nobody else sees; `carrl` and `run` stand for what they say."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rm", "true"], check=False).returncode:
        pytest.skip("this system lets nobody mount a file system in a namespace of its own")
    (tmp_path / "mount").mkdir()
    environment = os.environ | {
        "carrl": " ".join(CARRL),
        "mount": str(tmp_path / "mount"),
        "run": str(tmp_path / "mount" / "run"),
        "out": str(tmp_path),
        "overrides": " ".join(OVERRIDES),
    }
    subprocess.run(["unshare", "-rm", "bash", "-ec", script], env=environment, check=True, timeout=240)


def sentence_in(path: Path):
    *_, sentence = path.read_text().strip().splitlines()
    assert sentence.startswith("carrl: ")
    return sentence


@pytest.mark.slow
def test_a_full_disk_ends_the_run_which_goes_on_when_there_is_room(never_stopped, tmp_path):
    script = """
    mount -t tmpfs -o size=300k tmpfs "$mount"
    status=0; $carrl train $overrides hydra.run.dir="$run" 2>"$out/errors" || status=$?
    [[ $status == 2 ]]
    $carrl log check "$run/train.mcap"
    [[ -z $(find "$run" -name '*.partial') ]]
    mount -o remount,size=50m "$mount"
    cp -r "$run" "$out/copy"
    """
    in_namespace(script, tmp_path)
    assert "cannot be written: No space left on device" in sentence_in(tmp_path / "errors")
    assert_resumes(tmp_path / "copy", never_stopped)


@pytest.mark.slow
def test_a_read_only_folder_is_refused_and_nothing_is_lost(never_stopped, tmp_path):
    script = """
    mount -t tmpfs -o size=50m tmpfs "$mount"
    $carrl train $overrides trainer.frames=400 hydra.run.dir="$run"
    mount -o remount,ro "$mount"
    status=0; $carrl train resume="$run" 2>"$out/errors" || status=$?
    [[ $status == 2 ]]
    status=0; $carrl train $overrides hydra.run.dir="$mount/other" 2>"$out/errors of another" || status=$?
    [[ $status == 2 ]]
    cp -r "$run" "$out/copy"
    """
    in_namespace(script, tmp_path)
    for name in ("errors", "errors of another"):
        assert re.search(r"cannot be written: (\.lock: )?Read-only file system", sentence_in(tmp_path / name))
    assert main(["train", f"resume={tmp_path / 'copy'}", f"trainer.frames={FRAMES}"]) == 0
    assert_resumes(tmp_path / "copy", never_stopped)


@pytest.mark.slow
def test_a_full_shared_memory_does_not_matter(never_stopped, tmp_path):
    script = """
    mount -t tmpfs -o size=16k tmpfs /dev/shm
    head -c 16384 /dev/zero >/dev/shm/full || true
    ! touch /dev/shm/more || head -c 1 /dev/zero >/dev/shm/more && false || true
    $carrl train $overrides hydra.run.dir="$out/copy"
    """
    in_namespace(script, tmp_path)
    assert_resumes(tmp_path / "copy", never_stopped)


@pytest.mark.slow
@pytest.mark.parametrize("moved", [False, pytest.param(True, marks=pytest.mark.exhaustive)], ids=["deleted", "moved"])
def test_a_folder_deleted_or_moved_while_training_ends_the_run(moved, never_stopped, tmp_path):
    run = tmp_path / "run"
    process = start(run)
    wait_for(process, has_checkpoints(run))
    if moved:
        run.rename(tmp_path / "elsewhere")
    else:
        shutil.rmtree(run, ignore_errors=True)  # the run may write into it at the same time
    assert f"the run's folder '{run}' was deleted or moved while it trained" in last_words(process)
    if moved:
        assert_resumes(tmp_path / "elsewhere", never_stopped)


def test_a_loss_that_is_not_a_number_tells_its_update_batch_and_norms(tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", *OVERRIDES, "optimizer.lr=1e15", f"hydra.run.dir={run}"]) == 2
    *_, sentence = capsys.readouterr().err.strip().splitlines()
    assert "the loss is nan at update 2, frame 136, of seed 0: the rewards of its minibatch are " in sentence
    report = json.loads((run / "divergence.json").read_text())
    assert not math.isfinite(float(report["loss"]))
    assert (report["frame"], report["update"]) == (136, 2)
    assert len(report["items"]) == 128
    assert set(report["parameter_norms"]) == {
        f"module.0.module.{n}.{p}" for n in (0, 2, 4, 6) for p in ("weight", "bias")
    }
    verify(run / "train.mcap")
    assert main(["train", f"resume={run}"]) == 2, "the same run ends in the same way"
    assert main(["train", f"resume={run}", "optimizer.lr=1e-3", "trainer.frames=400"]) == 0


@pytest.mark.slow
def test_memory_that_runs_out_ends_the_run_with_a_sentence(tmp_path):
    run = tmp_path / "run"
    bound_memory = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({6 * 2**30}, {6 * 2**30}))"
    capacity = "replay_buffer.capacity=100000000"  # of 70 bytes each
    sentence = last_words(start(run, capacity, prelude=bound_memory))
    assert "out of memory; set a smaller replay_buffer.capacity" in sentence
    verify(run / "train.mcap")
    assert (run / "checkpoints" / "state.pt").exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_saves_the_run_and_ends_it(number, never_stopped, tmp_path):
    run = tmp_path / "run"
    process = start(run)
    wait_for(process, has_checkpoints(run))
    process.send_signal(number)
    output, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert f"interrupted; everything is saved: go on with carrl train resume={run}" in output
    assert len(load(run / "train.mcap")) == json.loads((run / "summary.json").read_text())["frames"] > 0
    assert_resumes(run, never_stopped)


@pytest.mark.slow
def test_a_second_signal_ends_the_process_at_once(tmp_path):
    run = tmp_path / "run"
    process = start(
        run, "env.num_envs=16384", "start.anywhere=true"
    )  # as many updates in a round, without a compiler: half a minute
    wait_for(process, lambda: (run / "train.mcap").exists() and (run / "train.mcap").stat().st_size > 2**18)
    process.send_signal(signal.SIGTERM)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=5)
    assert process.returncode == 130
    assert not (run / "summary.json").exists()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler to compile with")
def test_a_signal_does_not_wait_for_the_compiler(never_stopped, tmp_path):
    run = tmp_path / "run"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "TORCHINDUCTOR_CACHE_DIR": str(tmp_path)}
    process = start(run, "compile=true", "loss=dueling", env=environment)
    wait_for(process, lambda: list((tmp_path / "cache" / "carrl").glob("*")))
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert process.returncode == 130
    assert list((tmp_path / "cache").rglob("*.pt2")) == [], "the compilation was waited for"
    verify(run / "train.mcap")


@pytest.mark.slow
def test_kill_9_costs_nothing_but_time(never_stopped, tmp_path):
    run = tmp_path / "run"
    process = start(run)
    wait_for(process, has_checkpoints(run))
    process.kill()
    process.communicate()
    assert main(["train", f"resume={run}"]) == 0
    assert_resumes(run, never_stopped)
