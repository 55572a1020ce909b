"""Tiny runs that are stopped and gone on with, and how to compare two."""

import csv
import json

import torch

from carrl.cli.main import main
from carrl.cli.text.console import ProgressDisplay, RoadWarning
from carrl.log import load, read_episodes, verify
from carrl.train.checkpoint import load_checkpoint

FRAMES = 240
TINY = [
    "track=oval",
    "env.num_envs=8",
    "start.anywhere=true",
    "env.max_steps=20",
    "loss=double_dqn",
    f"trainer.frames={FRAMES}",
    "trainer.frames_per_update=2",
    "evaluation.interval=80",
    "target_updater.period=20",
    "replay_buffer.capacity=192",
    "replay_buffer.batch_size=32",
]
EAGER = [*TINY, "compile=false"]
MOMENTS = {
    "before the first step": 0,
    "before the first update": 24,
    "between two copies of the network": 88,
    "after an evaluation": 160,
    "when the buffer is full": 216,
}


def stop_at(monkeypatch, frames):
    """Lets every run of this process be interrupted after so many env steps, or before the first."""

    def interrupt(display, trainer):
        if trainer.frames >= frames:
            trainer.stop()

    monkeypatch.setattr(ProgressDisplay, "on_round", interrupt)
    if frames == 0:
        monkeypatch.setattr(RoadWarning, "on_start", lambda observer, trainer: trainer.stop())


def train(folder, *overrides):
    assert main(["train", *overrides, f"hydra.run.dir={folder}"]) == 0
    return folder


def interrupted(monkeypatch, folder, frames, *overrides):
    """A run that ended after so many env steps."""
    with monkeypatch.context() as patches:
        stop_at(patches, frames)
        assert main(["train", *overrides, f"hydra.run.dir={folder}"]) == 130
    assert not json.loads(next(folder.rglob("summary.json")).read_text())["finished"]
    return folder


def rows(path):
    """A table without what tells of wall time."""
    with path.open() as file:
        return [{key: value for key, value in row.items() if key != "wall_time_s"} for row in csv.DictReader(file)]


def assert_same_state(ours, theirs):
    """Whether two nested states are the same, bit for bit, but for wall time and what logs say of themselves."""
    if isinstance(theirs, torch.Tensor):
        assert torch.equal(ours, theirs)
    elif isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for key in theirs.keys() - {"wall_time_s", "first_update_s", "log", "tables", "config"}:
            assert_same_state(ours[key], theirs[key])
    elif isinstance(theirs, list | tuple):
        assert len(ours) == len(theirs)
        for pair in zip(ours, theirs, strict=True):
            assert_same_state(*pair)
    else:
        assert ours == theirs or (ours != ours and theirs != theirs)


def assert_same_run(ours, theirs):
    """Whether two runs' folders tell of the same training."""
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (ours, theirs)]
    for name in ("finished", "episodes", "frames", "updates", "evaluation", "last_evaluation"):
        assert summaries[0][name] == summaries[1][name]
    for name in ("best.pt", "last.pt"):
        assert (ours / "checkpoints" / name).read_bytes() == (theirs / "checkpoints" / name).read_bytes()
    for name in ("metrics.csv", "evaluations.csv"):
        assert rows(ours / name) == rows(theirs / name)
    assert (load(ours / "train.mcap") == load(theirs / "train.mcap")).all()
    assert list(read_episodes(ours / "train.mcap")) == list(read_episodes(theirs / "train.mcap"))
    verify(ours / "train.mcap")


def state_of(folder):
    return load_checkpoint(folder / "checkpoints" / "state.pt")
