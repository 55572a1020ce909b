"""Checkpoints and run folders as data that may be damaged or hostile."""

import json
import pickle

import pytest
import torch

from carrl.errors import CheckpointError, ConfigError
from carrl.train.checkpoint import load_checkpoint, save_checkpoint
from carrl.train.files import load_config


def test_what_is_saved_is_loaded(tmp_path):
    save_checkpoint(tmp_path / "checkpoints" / "best.pt", {"network": {"w": torch.arange(3.0)}, "frames": 5})
    state = load_checkpoint(tmp_path / "checkpoints" / "best.pt")
    assert torch.equal(state["network"]["w"], torch.arange(3.0))
    assert state["frames"] == 5
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["best.pt"]


@pytest.mark.parametrize("content", [b"", b"no checkpoint", pickle.dumps({"format_version": 1})])
def test_a_damaged_file_is_refused(tmp_path, content):
    (tmp_path / "best.pt").write_bytes(content)
    with pytest.raises(CheckpointError, match=r"best\.pt"):
        load_checkpoint(tmp_path / "best.pt")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match="does not exist"):
        load_checkpoint(tmp_path / "best.pt")


def test_another_format_version_is_refused(tmp_path):
    torch.save({"format_version": 99}, tmp_path / "best.pt")
    with pytest.raises(CheckpointError, match="format version 99"):
        load_checkpoint(tmp_path / "best.pt")


class Touch:
    """Creates a file when unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_a_checkpoint_that_would_run_code_does_not(tmp_path):
    torch.save({"format_version": 1, "network": Touch(tmp_path / "harmed")}, tmp_path / "best.pt")
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(tmp_path / "best.pt")
    assert not (tmp_path / "harmed").exists()


@pytest.mark.parametrize("target", ["os.system", "carrl.config.inspect.os.system", "builtins.eval", "carrl.nothing"])
def test_the_config_of_a_folder_cannot_name_code_outside_carrl(target, tmp_path):
    (tmp_path / ".hydra").mkdir()
    groups = ("vehicle", "action", "sensor", "observation", "reward", "start", "env", "network", "seed")
    config = {"track": {"_target_": target, "command": "true"}, **dict.fromkeys(groups)}
    (tmp_path / ".hydra" / "config.yaml").write_text(json.dumps(config))
    with pytest.raises(ConfigError, match=r"track\._target_"):
        load_config(tmp_path)


@pytest.mark.parametrize("content", ["", "[1, 2]", "track: x", "{", "!!python/object/apply:os.system ['true']"])
def test_a_folder_whose_config_is_damaged_is_refused(tmp_path, content):
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text(content)
    with pytest.raises(CheckpointError, match=r"config\.yaml"):
        load_config(tmp_path)


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match=r"config\.yaml' does not exist"):
        load_config(tmp_path)
    with pytest.raises(CheckpointError, match="is not a folder"):
        load_config(tmp_path / "nothing")
