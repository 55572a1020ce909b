"""The script that tells whether two runs learnt the same parameters."""

import pytest
import torch

from benchmarks.same_parameters import main
from carrl.train.checkpoint import save_checkpoint
from tests.run_folders import write_config

WEIGHT = torch.tensor([[0.5, -0.25], [0.0, 3.0]])


def write_checkpoints(folder, seed=0, **differing):
    """A run with small networks; `differing` replaces parameters of the best one."""
    write_config(folder, seed)
    network = {"0.weight": WEIGHT, "0.bias": torch.tensor([1.0, 2.0])}
    save_checkpoint(folder / "checkpoints" / "last.pt", {"network": network, "frames": seed})
    changed = {key.replace("_", "0."): value for key, value in differing.items()}
    save_checkpoint(folder / "checkpoints" / "best.pt", {"network": network | changed, "frames": 1})
    return folder


def compare(tmp_path):
    return main([str(tmp_path / "ours"), str(tmp_path / "theirs")])


def test_equal_parameters_are_the_same_whatever_else_differs(tmp_path, capsys):
    write_checkpoints(tmp_path / "ours", seed=1)
    write_checkpoints(tmp_path / "theirs", seed=2)
    assert compare(tmp_path) == 0
    assert capsys.readouterr().out == "the same parameters\n"


@pytest.mark.parametrize(
    "changed",
    [
        WEIGHT.nextafter(torch.tensor(9.0)),
        torch.where(WEIGHT == 0, -0.0, WEIGHT),
        WEIGHT.double(),
        WEIGHT.flatten(),
    ],
    ids=["the last bit", "a zero's sign", "the type", "the shape"],
)
def test_the_first_parameter_that_differs_is_named(changed, tmp_path, capsys):
    ours = write_checkpoints(tmp_path / "ours")
    write_checkpoints(tmp_path / "theirs", _weight=changed, _bias=torch.zeros(2))
    assert compare(tmp_path) == 1
    assert capsys.readouterr().out == f"not the same: {ours / 'checkpoints' / 'best.pt'}: 0.weight\n"


def test_a_parameter_that_only_one_has_is_a_difference(tmp_path, capsys):
    write_checkpoints(tmp_path / "ours")
    write_checkpoints(tmp_path / "theirs", _other=torch.zeros(1))
    assert compare(tmp_path) == 1
    assert capsys.readouterr().out.endswith("best.pt: 0.other\n")


def test_runs_of_several_seeds_are_compared_seed_by_seed(tmp_path, capsys):
    for name in ("ours", "theirs"):
        for seed in (2, 10):
            write_checkpoints(tmp_path / name / f"seed={seed}", seed)
    assert compare(tmp_path) == 0
    write_checkpoints(tmp_path / "theirs" / "seed=10", _weight=-WEIGHT)
    assert compare(tmp_path) == 1
    assert "seed=10" in capsys.readouterr().out
    write_checkpoints(tmp_path / "theirs" / "seed=11")
    assert compare(tmp_path) == 1
    assert "seeds: seed=2, seed=10 here, seed=2, seed=10, seed=11 there" in capsys.readouterr().out


def test_a_run_that_cannot_be_read_is_no_difference(tmp_path, capsys):
    write_checkpoints(tmp_path / "ours")
    assert compare(tmp_path) == 2
    assert "does not exist" in capsys.readouterr().err
