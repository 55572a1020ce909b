"""Commands under `python -W error`: whoever turns warnings on sees none that CarRL causes."""

import subprocess
import sys

import pytest

from tests.cli.log.conftest import write_log

OF_TORCHRL = ("-W", "ignore:Creating :DeprecationWarning")
"""torchrl 0.14 warns of its own deprecated classes while it is imported."""
TINY = ["track=oval", "env.num_envs=8", "trainer.frames=160", "replay_buffer.batch_size=16"]


def run_strictly(folder, *arguments):
    command = [sys.executable, "-W", "error", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("arguments", ["--help", "log info train.mcap", "log show train.mcap", "track list"])
def test_a_command_without_torchrl_warns_of_nothing(arguments, tmp_path):
    write_log(tmp_path / "train.mcap")
    done = run_strictly(tmp_path, "-m", "carrl.cli.main", *arguments.split())
    assert (done.returncode, done.stderr) == (0, "")


def test_training_evaluation_and_report_warn_of_nothing(tmp_path):
    verbs = [["train", *TINY, "hydra.run.dir=run"], ["evaluate", "run"], ["report", "run", "--curves", "curves.png"]]
    program = f"from carrl.cli.main import main; assert [main(verb) for verb in {verbs!r}] == [0, 0, 0]"
    done = run_strictly(tmp_path, *OF_TORCHRL, "-c", program)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
