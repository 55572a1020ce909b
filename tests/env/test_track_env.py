"""The driving task as TorchRL sees it."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from carrl import Reward, Sensor, Track, TrackEnv, Vehicle
from carrl.errors import ConfigError, TrackError


def drive(env, actions):
    """The transitions of one car that takes these actions, one TensorDict each."""
    state = env.reset()
    transitions = []
    for action in actions:
        transition, state = env.step_and_maybe_reset(state.set("action", torch.full(env.batch_size, action)))
        transitions.append(transition["next"])
    return transitions


@pytest.mark.parametrize("random_start", [False, True])
@pytest.mark.parametrize("num_envs", [1, 5])
def test_specs_match_what_the_environment_returns(num_envs, random_start):
    check_env_specs(TrackEnv(num_envs=num_envs, seed=0, random_start=random_start))


def test_shapes_and_types_are_the_documented_ones():
    env = TrackEnv(num_envs=3, seed=0)
    transition = env.rand_step(env.reset())
    expected = {
        "observation": ((3, 7), torch.float32),
        "action": ((3,), torch.int64),
        "pose": ((3, 3), torch.float32),
        ("next", "observation"): ((3, 7), torch.float32),
        ("next", "reward"): ((3, 1), torch.float32),
        ("next", "reward_terms"): ((3, 4), torch.float32),
        ("next", "done"): ((3, 1), torch.bool),
        ("next", "terminated"): ((3, 1), torch.bool),
        ("next", "truncated"): ((3, 1), torch.bool),
    }
    assert {key: (tuple(transition[key].shape), transition[key].dtype) for key in expected} == expected
    assert env.batch_size == (3,)


def test_sensor_range_and_angles_are_public():
    env = TrackEnv(sensor=Sensor(rays=3, field_of_view=180.0, max_range=15.0))
    assert env.sensor_range == 15.0
    torch.testing.assert_close(env.sensor_angles, torch.tensor([-torch.pi / 2, 0, torch.pi / 2]))


def test_observations_run_from_right_to_left():
    env = TrackEnv(sensor=Sensor(max_range=20.0))
    after_left = drive(env, [1, 1, 1])[-1]["observation"][0]
    assert after_left[-1] < after_left[0]  # the car came nearer to the left wall


def test_actions_are_forward_left_right():
    env = TrackEnv(num_envs=3)
    state = env.reset()
    heading = state["pose"][:, 2]
    after = env.step(state.set("action", torch.tensor([0, 1, 2])))["next", "pose"][:, 2]
    torch.testing.assert_close(after - heading, torch.tensor([0.0, 1 / 7.2, -1 / 7.2]))


def test_same_seed_same_rollout_whatever_else_draws_from_torch():
    first = TrackEnv(num_envs=4, seed=7, random_start=True).rollout(200, break_when_any_done=False)
    other = TrackEnv(num_envs=4, seed=7, random_start=True)
    torch.manual_seed(123)
    torch.rand(1000)
    assert (first == other.rollout(200, break_when_any_done=False)).all()


def test_different_seeds_give_different_rollouts():
    first, second = (TrackEnv(seed=seed).rollout(20)["action"] for seed in (0, 1))
    assert first.shape != second.shape or (first != second).any()


def test_the_environment_leaves_torchs_own_generator_alone():
    before = torch.get_rng_state()
    TrackEnv(num_envs=2, seed=0, random_start=True).rollout(50, break_when_any_done=False)
    assert torch.equal(before, torch.get_rng_state())


def test_a_batch_of_cars_drives_as_each_would_alone():
    together = TrackEnv(num_envs=3)
    state = together.reset()
    plans = torch.tensor([[0] * 40, [1, 2] * 20, [2, 1, 0, 0] * 10])
    poses = []
    for actions in plans.T:
        transition, state = together.step_and_maybe_reset(state.set("action", actions))
        poses.append(transition["next", "pose"])
    for car, plan in enumerate(plans.tolist()):
        alone = torch.stack([after["pose"][0] for after in drive(TrackEnv(), plan)])
        torch.testing.assert_close(torch.stack(poses)[:, car], alone)


def test_a_crash_terminates_and_only_that_car_starts_anew():
    env = TrackEnv(num_envs=2)
    state = env.reset()
    for _ in range(100):
        transition, state = env.step_and_maybe_reset(state.set("action", torch.tensor([1, 0])))
        if transition["next", "done"].any():
            break
    after = transition["next"]
    assert after["terminated"].tolist() == [[True], [False]]
    assert after["truncated"].tolist() == [[False], [False]]
    assert after["reward"][0, 0] == -200
    assert state["step"].tolist() == [0, after["step"][1].item()]
    torch.testing.assert_close(state["pose"][0], env.reset()["pose"][0])
    torch.testing.assert_close(state["pose"][1], after["pose"][1])
    assert not state["done"].any()


def test_the_step_limit_truncates_and_does_not_terminate():
    after = drive(TrackEnv(max_steps=5), [0] * 5)
    assert [step["truncated"].item() for step in after] == [False] * 4 + [True]
    assert [step["done"].item() for step in after] == [False] * 4 + [True]
    assert not any(step["terminated"].item() for step in after)


def test_a_crash_on_the_last_allowed_step_is_a_termination():
    crash_length = next(i for i, after in enumerate(drive(TrackEnv(), [1] * 60)) if after["done"].item()) + 1
    last = drive(TrackEnv(max_steps=crash_length), [1] * crash_length)[-1]
    assert (last["terminated"].item(), last["truncated"].item()) == (True, False)


def test_the_observation_of_a_finished_step_is_not_the_restarts():
    env = TrackEnv(max_steps=5)
    last = drive(env, [0] * 5)[-1]
    assert last["step"].item() == 5
    assert last["pose"][0, 0] == pytest.approx(env.reset()["pose"][0, 0].item() + 5, abs=1e-4)


def test_the_reward_is_the_sum_of_its_terms():
    rollout = TrackEnv(num_envs=8, seed=3).rollout(300, break_when_any_done=False)["next"]
    torch.testing.assert_close(rollout["reward"], rollout["reward_terms"].sum(-1, keepdim=True))
    assert (rollout["reward_terms"].amin(dim=(0, 1)) < 0).tolist() == [True, True, False, False]
    assert rollout["reward_terms"][..., 2].max() == 50


def test_random_starts_spread_over_the_track():
    env = TrackEnv(num_envs=64, seed=0, random_start=True)
    state = env.reset()
    assert (state["observation"] > 0.1).all()  # on the centreline, clear of walls
    assert len(state["next_gate"].unique()) == env.track.gate_count


def test_any_track_may_be_given_by_name_or_as_an_object():
    assert TrackEnv(track="oval").track.name == "oval"
    assert TrackEnv(track=Track.load("serpentine")).track.name == "serpentine"
    with pytest.raises(TrackError, match="no built-in track of this name"):
        TrackEnv(track="nowhere")


@pytest.mark.parametrize("wrong", [{"num_envs": 0}, {"max_steps": 0}])
def test_impossible_sizes_are_refused(wrong):
    with pytest.raises(ConfigError, match="at least 1"):
        TrackEnv(**wrong)


def test_a_different_car_can_be_driven():
    env = TrackEnv(vehicle=Vehicle(speed=20.0, time_step=0.2, turn_radius=30.0))
    state = env.reset()
    moved = env.step(state.set("action", torch.tensor([0])))["next", "pose"] - state["pose"]
    assert moved[0, :2].norm().item() == pytest.approx(4.0, abs=1e-5)


def test_the_last_action_can_be_observed():
    env = TrackEnv(num_envs=2, max_steps=3, observe_action=True)
    check_env_specs(env)
    state = env.reset()
    assert state["observation"][:, 7:].tolist() == [[1, 0, 0]] * 2
    first, second = (step["observation"] for step in drive(env, [1, 2]))
    assert (first[:, 7:].tolist(), second[:, 7:].tolist()) == ([[0, 1, 0]] * 2, [[0, 0, 1]] * 2)
    assert torch.equal(first[:, :7], drive(TrackEnv(num_envs=2), [1])[0]["observation"])


def test_steering_costs_reward_from_the_second_action_on():
    env = TrackEnv(num_envs=1, reward=Reward(turn=-1.0, switch=-3.0))
    steering = [step["reward_terms"][0, 3].item() for step in drive(env, [0, 1, 1, 2, 0])]
    assert steering == [0, -4, -1, -7, -3]


def test_cars_of_several_seeds_drive_as_they_would_alone():
    together = TrackEnv(num_envs=2, seed=[5, 6], random_start=True).rollout(150, break_when_any_done=False)
    for index, seed in enumerate((5, 6)):
        alone = TrackEnv(num_envs=2, seed=seed, random_start=True).rollout(150, break_when_any_done=False)
        assert (together[2 * index : 2 * index + 2] == alone).all()
        assert alone["next", "done"].any()
