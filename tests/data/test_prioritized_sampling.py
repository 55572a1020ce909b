"""Which transitions a prioritised buffer samples, and how much they weigh."""

import math

import pytest
import torch

from carrl.data.replay_buffer import Minibatches, make_prioritized_replay_buffer
from carrl.errors import ConfigError
from tests.data.test_collection import numbered_transitions


def make_buffer(items=4, seeds=(0,), alpha=1.0, beta=1.0, batch_size=4000):
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    buffer = make_prioritized_replay_buffer(8000, batch_size, alpha, beta, device="cpu", generators=generators)
    buffer.extend(numbered_transitions(0, items, replicates=len(seeds)))
    return buffer


def minibatch(buffer):
    drawn = next(buffer.sampler.minibatches(buffer.storage, 1, buffer.batch_size))
    return Minibatches(*(each[0] for each in drawn))


def note(buffer, errors):
    """Notes the TD errors of the first transitions, alike for all replicates."""
    replicates = buffer.sampler.replicates
    items = torch.arange(len(errors))[:, None].expand(-1, replicates)
    buffer.sampler.set_priorities(items, torch.tensor(errors)[:, None].expand(-1, replicates))


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_transitions_are_sampled_in_proportion_to_their_td_error_to_the_alpha(alpha):
    buffer = make_buffer(alpha=alpha)
    note(buffer, [1.0, 4.0, 9.0, 16.0])
    shares = minibatch(buffer).items.flatten().bincount()
    expected = torch.tensor([1.0, 4.0, 9.0, 16.0]) ** alpha
    torch.testing.assert_close(shares / shares.sum(), expected / expected.sum(), atol=0.03, rtol=0)


@pytest.mark.parametrize("beta", [0.0, 0.5, 1.0])
def test_weights_make_up_for_the_sampling(beta):
    buffer = make_buffer(beta=beta)
    note(buffer, [1.0, 4.0, 9.0, 16.0])
    drawn = minibatch(buffer)
    expected = torch.tensor([1.0, 4.0, 9.0, 16.0])[drawn.items] ** -beta
    torch.testing.assert_close(drawn.weights / drawn.weights.max(), expected / expected.max())


def test_new_transitions_have_the_greatest_priority_so_far():
    buffer = make_buffer(items=3)
    note(buffer, [1.0, 8.0, 2.0])
    note(buffer, [1.0, 1.0, 2.0])
    buffer.extend(numbered_transitions(3, 1))
    shares = minibatch(buffer).items.flatten().bincount() / 4000
    torch.testing.assert_close(shares, torch.tensor([1.0, 1.0, 2.0, 8.0]) / 12, atol=0.03, rtol=0)


def test_a_transition_without_error_is_still_sampled_some_day():
    buffer = make_buffer(alpha=0.1)
    note(buffer, [0.0, 1.0, 1.0, 1.0])
    assert (minibatch(buffer).items == 0).any()


def test_every_agent_samples_by_its_own_priorities_as_it_would_alone():
    together = make_buffer(seeds=(3, 7))
    items = torch.arange(4)[:, None].expand(-1, 2)
    together.sampler.set_priorities(items, torch.tensor([[1.0, 5.0], [2.0, 0.0], [3.0, 1.0], [4.0, 1.0]]))
    drawn = minibatch(together)
    for replicate, (seed, errors) in enumerate([(3, [1.0, 2.0, 3.0, 4.0]), (7, [5.0, 0.0, 1.0, 1.0])]):
        alone = make_buffer(seeds=(seed,))
        note(alone, errors)
        own = minibatch(alone)
        assert torch.equal(own.items[:, 0], drawn.items[:, replicate])
        assert torch.equal(own.weights[:, 0], drawn.weights[:, replicate])


def test_priorities_and_generators_are_kept_in_the_state():
    buffer, resumed = make_buffer(seeds=(3, 7)), make_buffer(seeds=(0, 1))
    note(buffer, [1.0, 2.0, 3.0])
    minibatch(buffer)
    resumed.sampler.load_state_dict(buffer.sampler.state_dict())
    for ours, theirs in zip(minibatch(resumed), minibatch(buffer), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize(("key", "value"), [("alpha", -0.1), ("alpha", math.nan), ("beta", 1.5)])
def test_exponents_outside_0_to_1_are_refused(key, value):
    with pytest.raises(ConfigError, match=rf"replay_buffer\.{key} is {value}; it must lie in 0\.\.1"):
        make_buffer(**{key: value})
