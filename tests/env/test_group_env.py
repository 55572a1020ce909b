"""Learners that share a world, as TorchRL's multi-agent algorithms and PettingZoo see them."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from carrl import ContinuousActions, TrackEnv
from carrl.env.group_env import GroupTrackEnv
from carrl.errors import ConfigError
from carrl.opponents.line import LineOpponents
from carrl.sim.kinematic import Kinematic

DRIVEN = {"vehicle": Kinematic(), "action": ContinuousActions()}


def made(**options):
    return TrackEnv("paper", num_envs=6, seed=0, cars_per_world=3, max_steps=30, **options)


@pytest.mark.parametrize("own", [{}, DRIVEN], ids=["steered", "driven"])
def test_torchrl_finds_the_specs_of_the_group_kept(own):
    check_env_specs(GroupTrackEnv(made(**own)))


def test_the_group_is_the_cars_of_each_world_side_by_side():
    env, flat = GroupTrackEnv(made()), made()
    assert env.group_map == {"cars": ["car_0", "car_1", "car_2"]}
    grouped = env.rollout(60, break_when_any_done=False)
    alone = flat.rollout(60, break_when_any_done=False)
    for key in ("observation", "reward", "done", "pose"):
        assert torch.equal(grouped["next", "cars", key].transpose(1, 2).flatten(0, 1), alone["next", key])
    assert alone["next", "done"].any()


def test_cars_that_share_no_world_are_no_group():
    opponents = {"cars_per_world": 3, "opponents": LineOpponents()}
    for env in (TrackEnv("paper", num_envs=3), TrackEnv("paper", num_envs=3, **opponents)):
        with pytest.raises(ConfigError, match="do not share worlds; set cars_per_world"):
            GroupTrackEnv(env)


def parallel(**options):
    from carrl.env.parallel_env import parallel_env

    return parallel_env("paper", cars=3, **options)


@pytest.mark.filterwarnings("ignore:The old environment creation API:DeprecationWarning")  # within PettingZoo 1.27
@pytest.mark.parametrize("own", [{}, DRIVEN, {"opponents": LineOpponents()}], ids=["steered", "driven", "among line"])
def test_pettingzoo_finds_its_rules_kept(own):
    env = parallel(max_steps=50, **own)
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    parallel_api_test(env, num_cycles=200)
    parallel_seed_test(lambda: parallel(max_steps=50, **own), num_cycles=50)


def test_a_car_whose_episode_is_over_leaves_the_road():
    env = parallel()
    env.reset(seed=0)
    while len(env.agents) == 3:
        env.step({agent: 1 if agent == "car_1" else 0 for agent in env.agents})
    assert "car_1" not in env.agents
    state = env._now.state.cars
    assert state.state[1].isnan().all()
    assert not env.task.simulator.look(state)[1].any()
