"""The same run in another process and another folder is the same run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from carrl.cli.main import main
from carrl.log import read_columns, read_episodes
from carrl.train.checkpoint import load_checkpoint

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
RUN = (
    *("experiment=smoke", "compile=false", "seed=3", "threads=1", "trainer.frames=160", "evaluation.interval=80"),
    *("replay_buffer.batch_size=16", "sensor.noise=0.1", "start.anywhere=true", "hydra.run.dir=run"),
)


@pytest.mark.slow
def test_two_processes_in_two_folders_learn_the_same_to_the_bit(tmp_path, monkeypatch):
    runs = [tmp_path / "one" / "run", tmp_path / "another" / "folder" / "run"]
    for run in runs:
        run.parent.mkdir(parents=True)
    hash_seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"  # another one than of this process
    environment = {**os.environ, **ONE_THREAD, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "carrl.cli.main", "train", *RUN]
    done = subprocess.run(command, cwd=runs[0].parent, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    monkeypatch.chdir(runs[1].parent)
    assert main(["train", *RUN]) == 0
    one, other = (read_columns(run / "train.mcap") for run in runs)
    assert len(one["action"]) == 160
    assert {name: values.tobytes() for name, values in one.items()} == {
        name: values.tobytes() for name, values in other.items()
    }
    assert read_episodes(runs[0] / "train.mcap") == read_episodes(runs[1] / "train.mcap") != []
    for checkpoint in ("best", "last"):
        one, other = (load_checkpoint(run / "checkpoints" / f"{checkpoint}.pt")["network"] for run in runs)
        assert one.keys() == other.keys()
        assert all(torch.equal(one[name], other[name]) for name in one)
