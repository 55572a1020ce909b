"""Collector and replay buffer."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from carrl.data.collector import CarCollector, make_collector
from carrl.data.replay_buffer import KEYS, make_replay_buffer
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError
from carrl.opponents.rule import RuleOpponents
from carrl.sim.sensor import Sensor
from carrl.task.task import Start


def numbered_transitions(first, count, replicates=1):
    """Transitions [count, replicates]; those of replicate a have numbers above 1000 a."""
    numbers = torch.arange(first, first + count)[:, None] + 1000 * torch.arange(replicates)
    flag = torch.zeros(count, replicates, 1, dtype=torch.bool)
    values = {
        "observation": numbers[..., None].float(),
        "action": numbers,
        "next": {"observation": numbers[..., None].float() + 1, "reward": numbers[..., None] * 10.0},
    }
    values["next"] |= {"done": flag, "terminated": flag.clone()}
    return TensorDict(values, batch_size=[count, replicates])


def make_buffer(capacity=8, batch_size=4, seeds=(0,)):
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    return make_replay_buffer(capacity, batch_size, device="cpu", generators=generators)


def test_the_buffer_keeps_the_latest_transitions_and_drops_the_oldest():
    buffer = make_buffer(capacity=8)
    for first in range(0, 12, 3):
        buffer.extend(numbered_transitions(first, 3))
    assert sorted(buffer[:]["action"].flatten().tolist()) == list(range(4, 12))


def test_sampled_transitions_stay_whole():
    buffer = make_buffer(capacity=100, batch_size=64, seeds=(0, 1))
    buffer.extend(numbered_transitions(0, 100, replicates=2))
    sample = buffer.sample()
    assert sample.batch_size == (64, 2)
    assert torch.equal(sample["next", "reward"][..., 0], sample["action"] * 10.0)
    assert torch.equal(sample["next", "observation"], sample["observation"] + 1)


def test_sampling_follows_the_buffers_own_generator():
    def draw(*seeds):
        buffer = make_buffer(capacity=1000, batch_size=32, seeds=seeds)
        buffer.extend(numbered_transitions(0, 1000, replicates=len(seeds)))
        return buffer.sample()["action"]

    first = draw(1)
    torch.rand(7)
    assert torch.equal(first, draw(1))
    assert not torch.equal(first, draw(2))


def test_every_agent_samples_its_own_transitions_as_it_would_alone():
    def draw(*seeds):
        buffer = make_buffer(capacity=1000, batch_size=32, seeds=seeds)
        buffer.extend(numbered_transitions(0, 1000, replicates=len(seeds)))
        return buffer.sample()["action"]

    together = draw(1, 2)
    assert torch.equal(together[:, 0], draw(1)[:, 0])
    assert torch.equal(together[:, 1] - 1000, draw(2)[:, 0])


def test_a_batch_larger_than_the_memory_is_refused():
    with pytest.raises(ConfigError, match="batch_size is 9 and capacity is 8"):
        make_buffer(batch_size=9)


def test_collected_steps_continue_across_batches_and_episodes():
    env = TrackEnv(num_envs=2, max_steps=7)

    def forward(state):
        return state.set("action", torch.zeros(2, dtype=torch.int64))

    collector = make_collector(3, env=env, policy=forward)
    steps, truncated = [], []
    for _, batch in zip(range(5), collector, strict=False):
        assert batch.batch_size == (2, 3)
        assert set(KEYS) <= set(batch.keys(include_nested=True))
        steps += batch["step"][0].tolist()
        truncated += batch["next", "truncated"][0, :, 0].tolist()
        assert torch.equal(batch["next", "step"], batch["step"] + 1)  # not the restart's
    collector.shutdown()
    assert steps == [*range(7), *range(7), 0]
    assert [index for index, cut in enumerate(truncated) if cut] == [6, 13]


def test_an_empty_batch_of_steps_is_refused():
    with pytest.raises(ConfigError, match="steps_per_batch is 0"):
        make_collector(0, env=TrackEnv(), policy=lambda state: state)


def batches(env, steps):
    """Twelve batches of cars that a policy drives which does the next action in each step."""
    policy = TensorDictModule(lambda step: step % 3, in_keys=["step"], out_keys=["action"])
    collector = make_collector(steps, env=env, policy=policy)
    return [batch.clone() for _, batch in zip(range(12), collector, strict=False)]


@pytest.mark.parametrize("steps", [1, 4])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"start": Start(anywhere=True), "sensor": Sensor(noise=0.1), "seed": [3, 7]},
        {"start": Start(anywhere=True), "cars_per_world": 3},
        {"cars_per_world": 3, "opponents": RuleOpponents(pace=0.5), "seed": 1},
    ],
    ids=["from the line", "anywhere", "among learners", "among opponents"],
)
def test_batches_are_those_of_torchrls_own_collector_and_reset(options, steps, monkeypatch):
    def make_env():
        return TrackEnv("oval", num_envs=6, max_steps=9, **({"seed": 3} | options))

    own = batches(make_env(), steps)
    for owner, names in ((TrackEnv, ["_step_and_maybe_reset"]), (CarCollector, ["iterator", "rollout"])):
        for name in names:
            monkeypatch.delattr(owner, name)  # so that TorchRL's is left
    theirs = batches(make_env(), steps)
    assert any(batch["next", "done"].any() for batch in own)
    for ours, plain in zip(own, theirs, strict=True):
        assert ours.batch_size == plain.batch_size
        assert set(ours.keys(True, True)) == set(plain.keys(True, True))
        assert (ours == plain).all()
