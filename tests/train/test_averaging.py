"""Averages of networks' weights: their numbers, and the runs that try them out."""

import pytest
import torch
from torch import nn

from carrl.cli.main import main
from carrl.errors import ConfigError
from carrl.train.averaging import WeightAverages
from carrl.train.build import build_pipeline
from carrl.train.checkpoint import load_checkpoint
from tests.configs import compose
from tests.stopped_runs import EAGER, TINY, assert_same_run, assert_same_state, interrupted, state_of, train

AVERAGED = "evaluation.averaged_updates=20"


def follow(horizon, values):
    """The average after updates that set the one weight to these values, and the network."""
    network = nn.Linear(1, 1, bias=False)
    network.weight.data.fill_(100.0)
    averages = WeightAverages([network], horizon)
    for number, value in enumerate(values):
        network.weight.data.fill_(value)
        averages.follow(number + 1)
    return averages, network


def average(averages, network):
    with averages.in_place():
        return network.weight.item()


def test_until_the_horizon_all_updates_count_alike_and_what_was_before_them_not_at_all():
    assert average(*follow(10, [1.0, 2.0, 6.0])) == pytest.approx(3.0)


def test_beyond_the_horizon_each_update_counts_for_one_in_so_many():
    assert average(*follow(2, [1.0, 3.0, 4.0, 8.0])) == pytest.approx(((1 + 3) / 2 / 2 + 4 / 2) / 2 + 8 / 2)


def test_several_updates_at_once_count_as_that_many_with_the_weight_after_the_last():
    averages, network = follow(4, [2.0] * 4)
    network.weight.data.fill_(10.0)
    averages.follow(7)
    assert average(averages, network) == pytest.approx(10 - 8 * 0.75**3)


def test_the_networks_have_their_own_weights_again_afterwards_even_after_an_error():
    averages, network = follow(10, [1.0, 2.0])
    with pytest.raises(KeyError), averages.in_place():
        raise KeyError
    assert network.weight.item() == 2.0


@pytest.mark.parametrize(("seeds", "run"), [("[1]", EAGER), ("[1,2]", EAGER), ("[1,2]", TINY)])
def test_a_run_learns_the_same_and_keeps_the_average(tmp_path, seeds, run):
    common = [*run, f"trainer.seeds={seeds}"]
    plain, averaged = train(tmp_path / "plain", *common), train(tmp_path / "averaged", *common, AVERAGED)
    one, other = state_of(averaged), state_of(plain)
    assert_same_state(one["algorithm"], other["algorithm"])
    kept = [load_checkpoint(each / "checkpoints/last.pt")["network"] for each in sorted(averaged.rglob("seed=*"))]
    weights = [weight for network in kept for weight in network.values()]
    assert len(weights) == len(one["averages"])
    for weight, expected in zip(weights, one["averages"], strict=True):
        assert torch.equal(weight, expected)
    own = load_checkpoint(sorted(plain.rglob("seed=*"))[0] / "checkpoints/last.pt")["network"]
    for weight, without in zip(kept[0].values(), own.values(), strict=True):
        assert not torch.equal(weight, without)
        torch.testing.assert_close(weight, without, atol=0.1, rtol=0.1)


def test_a_run_that_was_stopped_goes_on_with_its_averages(tmp_path, monkeypatch):
    whole = train(tmp_path / "whole", *EAGER, AVERAGED)
    folder = interrupted(monkeypatch, tmp_path / "stopped", 120, *EAGER, AVERAGED)
    kept = load_checkpoint(folder / "checkpoints/last.pt")["network"]
    for weight, expected in zip(kept.values(), state_of(folder)["averages"], strict=True):
        assert torch.equal(weight, expected)
    assert main(["train", f"resume={folder}"]) == 0
    assert_same_run(folder, whole)


@pytest.mark.parametrize("value", ["0", "1.5", "true"])
def test_no_number_of_updates_is_refused(value):
    with pytest.raises(ConfigError, match=r"evaluation\.averaged_updates is .*; it must be "):
        build_pipeline(compose(f"evaluation.averaged_updates={value}"))
