"""Returns over several steps, worked by hand."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import MultiStep

from carrl.algorithms.common.optimizer import make_hard_update
from carrl.algorithms.dqn.loss import make_dqn_loss
from carrl.data.replay_buffer import NStepReturns
from carrl.errors import ConfigError
from tests.algorithms.test_learning_rules import linear_network

GAMMA = 0.5


def steps(rewards, terminated=(), truncated=()):
    """Transitions [T, N, A] from rewards [T][N], of one replicate; observations tell time and car: 10 t + n."""
    reward = torch.tensor(rewards, dtype=torch.float32)[..., None, None]
    number = 10.0 * torch.arange(len(reward))[:, None] + torch.arange(reward.shape[1])
    ends = [torch.zeros_like(reward, dtype=torch.bool) for _ in range(2)]
    for flags, places in zip(ends, (terminated, truncated), strict=True):
        for place in places:
            flags[place] = True
    following = {"observation": number[..., None, None] + 10, "reward": reward}
    following |= {"terminated": ends[0], "done": ends[0] | ends[1]}
    values = {"observation": number[..., None, None], "action": number[..., None].long(), "next": following}
    return TensorDict(values, batch_size=reward.shape[:3])


def column(transitions, *key):
    return transitions[key][:, :, 0].flatten(1).tolist()


def test_three_rewards_are_summed_with_the_discount_and_the_observation_is_the_one_after_them():
    summed = NStepReturns(3, gamma=GAMMA)(steps([[1], [2], [4], [8], [16]]))
    assert column(summed, "observation") == [[0], [10], [20]]
    assert column(summed, "next", "reward") == [[1 + 1 + 1], [2 + 2 + 2], [4 + 4 + 4]]
    assert column(summed, "next", "observation") == [[30], [40], [50]]
    assert column(summed, "steps_to_next_obs") == [[3], [3], [3]]
    assert not summed["next", "done"].any()


@pytest.mark.parametrize("end", ["terminated", "truncated"])
def test_a_sum_ends_where_its_own_cars_episode_ends(end):
    """The second car's episode ends with the second step; the first one's does not."""
    returns = NStepReturns(3, gamma=GAMMA)
    summed = returns(steps([[1, 1], [2, 2], [4, 4], [8, 8], [16, 16]], **{end: [(1, 1)]}))
    assert column(summed, "next", "reward") == [[3, 1 + 1], [6, 2], [12, 12]]
    assert column(summed, "next", "observation") == [[30, 21], [40, 21], [50, 51]]
    assert column(summed, "steps_to_next_obs") == [[3, 2], [3, 1], [3, 3]]
    assert column(summed, "next", "done") == [[False, True], [False, True], [False, False]]
    assert column(summed, "next", "terminated") == [[False, end == "terminated"]] * 2 + [[False, False]]


@pytest.mark.parametrize("sizes", [[1] * 9, [2, 3, 4], [9]])
def test_steps_that_come_in_pieces_give_the_same_as_all_at_once(sizes):
    whole = steps([[float(t)] for t in range(9)], terminated=[(3, 0)], truncated=[(6, 0)])
    returns, pieces = NStepReturns(3, gamma=0.9), []
    for piece in whole.split(sizes):
        pieces.append(returns(piece))
    assert (torch.cat(pieces) == NStepReturns(3, gamma=0.9)(whole)).all()
    assert len(torch.cat(pieces)) == 9 - 2


def test_pending_steps_are_kept_in_the_state():
    whole = steps([[float(t)] for t in range(6)], terminated=[(2, 0)])
    returns = NStepReturns(3, gamma=0.9)
    returns(whole[:3])
    resumed = NStepReturns(3, gamma=0.9)
    resumed.load_state_dict(returns.state_dict())
    assert (resumed(whole[3:]) == returns(whole[3:])).all()
    with pytest.raises(ValueError, match="pending in returns of 2 steps"):
        NStepReturns(2, gamma=0.9).load_state_dict(returns.state_dict())


def test_one_step_leaves_transitions_as_they_are():
    whole = steps([[1], [2]], terminated=[(0, 0)])
    summed = NStepReturns(1, gamma=GAMMA)(whole)
    assert (summed.exclude("steps_to_next_obs") == whole).all()
    assert (summed["steps_to_next_obs"] == 1).all()


def test_torchrls_own_sums_are_the_same_but_it_leaves_the_end_to_the_last_step():
    generator = torch.Generator().manual_seed(0)
    rewards = torch.randn(30, 2, generator=generator).tolist()
    whole = steps(rewards, terminated=[(7, 0), (12, 1)], truncated=[(20, 0), (21, 1)])
    ours = NStepReturns(3, gamma=0.9)(whole)
    theirs = MultiStep(gamma=0.9, n_steps=3)(whole[:, :, 0].transpose(0, 1)).transpose(0, 1)[:28]
    for key in (("next", "reward"), ("next", "observation")):
        torch.testing.assert_close(ours[key][:, :, 0], theirs[key])
    assert torch.equal(ours["steps_to_next_obs"][:, :, 0, 0], theirs["steps_to_next_obs"])
    assert ours["next", "terminated"][5, 0, 0]
    assert not theirs["next", "terminated"][5, 0]  # if it is, carrl.data.replay_buffer may build on it


@pytest.mark.parametrize(("double_dqn", "next_value"), [(False, 7.0), (True, 5.0)])
@pytest.mark.parametrize("terminated", [False, True])
def test_the_loss_discounts_what_follows_by_as_many_steps(double_dqn, next_value, terminated):
    loss = make_dqn_loss(GAMMA, "l2", double_dqn, network=linear_network([1.0, 4.0, 2.0]))
    make_hard_update(1000, loss=loss)
    target = torch.tensor([3.0, 5.0, 7.0])[:, None]
    loss.target_value_network_params["module", "0", "module", "weight"].data.copy_(target)
    one = torch.ones(1, 1)
    following = {"observation": one, "reward": 2 * one, "terminated": one.bool() & terminated}
    following["done"] = following["terminated"]
    transition = {"observation": one, "action": torch.tensor([0]), "next": following}
    batch = TensorDict(transition | {"steps_to_next_obs": torch.tensor([[3]])}, [1])
    expected = 2.0 + (not terminated) * GAMMA**3 * next_value - 1.0
    assert loss(batch)["loss"].item() == pytest.approx(expected**2)


def test_fewer_than_one_step_is_refused():
    with pytest.raises(ConfigError, match=r"returns\.steps is 0; it must be at least 1"):
        NStepReturns(0, gamma=GAMMA)
