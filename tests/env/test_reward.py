"""The paper's reward, worked by hand."""

import torch

from carrl.env.reward import TERMS, Reward


def terms_of(nearest, collided=False, gates=0, reward=None):
    observation = torch.tensor([[1.0, nearest, 0.7]])
    return (reward or Reward()).terms(observation, torch.tensor([collided]), torch.tensor([gates]))[0].tolist()


def test_the_terms_are_collision_proximity_and_gate():
    assert TERMS == ("collision", "proximity", "gate")


def test_driving_in_the_open_earns_nothing():
    assert terms_of(nearest=0.5) == [0, 0, 0]


def test_a_sensor_below_a_tenth_costs_20():
    assert terms_of(nearest=0.0999) == [0, -20, 0]


def test_a_sensor_at_exactly_a_tenth_costs_nothing():
    assert terms_of(nearest=0.1) == [0, 0, 0]


def test_a_collision_costs_200_and_not_20_on_top():
    assert terms_of(nearest=0.01, collided=True) == [-200, 0, 0]


def test_every_gate_earns_50():
    assert terms_of(nearest=0.5, gates=1) == [0, 0, 50]
    assert terms_of(nearest=0.05, gates=2) == [0, -20, 100]


def test_all_weights_are_parameters():
    reward = Reward(collision=-1.0, proximity=-2.0, gate=3.0, proximity_threshold=0.6)
    assert terms_of(nearest=0.5, gates=1, reward=reward) == [0, -2, 3]
    assert terms_of(nearest=0.5, collided=True, reward=reward) == [-1, 0, 0]
