"""Other libraries take the Gymnasium environments as they are: TorchRL's wrappers, and Gymnasium's to torch."""

import gymnasium
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import GymEnv, GymWrapper
from torchrl.envs.utils import check_env_specs

import carrl
from carrl.task.episode import Start


def always(action):
    """A policy that does the same in each step."""
    return TensorDictModule(lambda _: torch.tensor(action), in_keys=["observation"], out_keys=["action"])


def test_torchrl_makes_one_car_by_its_id():
    env = GymEnv("carrl/Track-v0", track="oval", start=Start(anywhere=True), categorical_action_encoding=True)
    check_env_specs(env)
    rollout = env.rollout(60, policy=always(1))
    assert rollout["next", "terminated"].squeeze(-1).tolist() == [False] * (len(rollout) - 1) + [True]
    assert rollout["next", "reward"][-1] == -200


@pytest.mark.parametrize("mode", ["Disabled", "SameStep"])
def test_torchrl_wraps_many_cars_and_sees_each_episodes_end_and_new_start(mode):
    options = {"num_envs": 3, "track": "oval", "max_episode_steps": 4}
    env = GymWrapper(
        gymnasium.make_vec("carrl/Track-v0", autoreset_mode=mode, **options), categorical_action_encoding=True
    )
    ours = carrl.TrackEnv("oval", num_envs=3, max_steps=4)
    theirs, own = (each.rollout(10, policy=always([0, 1, 2]), break_when_any_done=False) for each in (env, ours))
    for key in ("observation", ("next", "observation"), ("next", "reward"), ("next", "truncated"), ("next", "done")):
        torch.testing.assert_close(theirs[key], own[key], check_dtype=False, msg=str(key))
    assert theirs["next", "truncated"].sum() == 6


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_gymnasiums_wrapper_to_torch_takes_observations_and_infos(mode):
    pytest.importorskip("array_api_compat", reason="Gymnasium's wrapper needs it; pip install 'gymnasium[array-api]'")
    from gymnasium.wrappers.vector import NumpyToTorch

    env = NumpyToTorch(gymnasium.make_vec("carrl/Track-v0", num_envs=3, autoreset_mode=mode, track=["oval", "paper"]))
    env.reset(seed=0)
    view, reward, *_, infos = env.step(torch.tensor([0, 1, 2]))
    assert view.dtype == torch.float32 and reward.shape == (3,)
    assert infos["track"].tolist() == [0, 1, 0]
