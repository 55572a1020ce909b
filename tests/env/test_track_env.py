"""The driving task as TorchRL sees it."""

import inspect
import multiprocessing
import pickle
from functools import partial

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from carrl import Reward, Sensor, Start, Track, TrackEnv, Vehicle, paper_reward, rays_and_last_action
from carrl.errors import ConfigError, TrackError
from carrl.sim.simulator import Simulator
from carrl.task.reward import Shaping


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
    check_env_specs(TrackEnv(num_envs=num_envs, seed=0, start=Start(anywhere=random_start)))


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
    first = TrackEnv(num_envs=4, seed=7, start=Start(anywhere=True)).rollout(200, break_when_any_done=False)
    other = TrackEnv(num_envs=4, seed=7, start=Start(anywhere=True))
    torch.manual_seed(123)
    torch.rand(1000)
    assert (first == other.rollout(200, break_when_any_done=False)).all()


def test_different_seeds_give_different_rollouts():
    first, second = (TrackEnv(seed=seed).rollout(20)["action"] for seed in (0, 1))
    assert first.shape != second.shape or (first != second).any()


def test_the_environment_leaves_torchs_own_generator_alone():
    before = torch.get_rng_state()
    TrackEnv(num_envs=2, seed=0, start=Start(anywhere=True)).rollout(50, break_when_any_done=False)
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
    env = TrackEnv(num_envs=64, seed=0, start=Start(anywhere=True))
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
    env = TrackEnv(num_envs=2, max_steps=3, observation=rays_and_last_action())
    check_env_specs(env)
    state = env.reset()
    assert state["observation"][:, 7:].tolist() == [[1, 0, 0]] * 2
    first, second = (step["observation"] for step in drive(env, [1, 2]))
    assert (first[:, 7:].tolist(), second[:, 7:].tolist()) == ([[0, 1, 0]] * 2, [[0, 0, 1]] * 2)
    assert torch.equal(first[:, :7], drive(TrackEnv(num_envs=2), [1])[0]["observation"])


def test_steering_costs_reward_from_the_second_action_on():
    env = TrackEnv(num_envs=1, reward=paper_reward(turn=-1.0, switch=-3.0))
    steering = [step["reward_terms"][0, 3].item() for step in drive(env, [0, 1, 1, 2, 0])]
    assert steering == [0, -4, -1, -7, -3]


def test_cars_of_several_seeds_drive_as_they_would_alone():
    together = TrackEnv(num_envs=2, seed=[5, 6], start=Start(anywhere=True)).rollout(150, break_when_any_done=False)
    for index, seed in enumerate((5, 6)):
        alone = TrackEnv(num_envs=2, seed=seed, start=Start(anywhere=True)).rollout(150, break_when_any_done=False)
        assert (together[2 * index : 2 * index + 2] == alone).all()
        assert alone["next", "done"].any()


# Many tracks


def test_cars_take_the_tracks_in_turn():
    env = TrackEnv(track=["oval", Track.random(3), "serpentine"], num_envs=7)
    check_env_specs(env)
    assert [track.name for track in env.tracks] == ["oval", "random-3", "serpentine"]
    state = env.reset()
    assert state["track"].tolist() == [0, 1, 2, 0, 1, 2, 0]
    for index, track in enumerate(env.tracks):
        torch.testing.assert_close(state["pose"][index], track.pose_at(torch.zeros(1))[0])


def test_cars_on_different_tracks_drive_as_alone_on_theirs():
    together = TrackEnv(track=["oval", "serpentine"], num_envs=2)
    state, plan = together.reset(), [0, 1, 0, 2, 0, 0, 1, 1] * 10
    observations = []
    for action in plan:
        transition, state = together.step_and_maybe_reset(state.set("action", torch.full((2,), action)))
        observations.append(transition["next", "observation"])
    for index, name in enumerate(("oval", "serpentine")):
        alone = torch.stack([after["observation"][0] for after in drive(TrackEnv(track=name), plan)])
        torch.testing.assert_close(torch.stack(observations)[:, index], alone)


def test_a_sampled_track_changes_from_episode_to_episode_and_follows_the_seed():
    def tracks(seed: int) -> torch.Tensor:
        env = TrackEnv(
            ["oval", "paper", "serpentine"],
            num_envs=4,
            seed=seed,
            start=Start(sample_track=True),
            max_steps=3,
        )
        return env.rollout(60, break_when_any_done=False)["track"]

    assert torch.equal(tracks(1), tracks(1))
    assert not torch.equal(tracks(1), tracks(2))
    counts = tracks(1)[:, ::3].flatten().bincount(minlength=3)
    assert (counts > 10).all()


def test_mirrored_and_reversed_episodes_are_drawn_by_chance():
    env = TrackEnv("paper", num_envs=400, seed=0, start=Start(mirrored=True, reversed=True))
    check_env_specs(env)
    names = ["paper", "paper-mirrored", "paper-reversed", "paper-mirrored-reversed"]
    assert [track.name for track in env.tracks] == names
    state = env.reset()
    counts = state["track"].bincount(minlength=4)
    assert counts.min() > 70 and counts.sum() == 400
    plain, mirrored = (state["observation"][state["track"] == index][0] for index in (0, 1))
    torch.testing.assert_close(plain.flip(0), mirrored)


def test_starts_vary_beside_the_centreline_and_in_heading():
    env = TrackEnv("oval", num_envs=300, seed=0, start=Start(offset=1.0, heading_jitter=20.0))
    check_env_specs(env)
    pose = env.reset()["pose"]
    assert pose[:, 0].std() < 1e-3  # all on the start line, which runs along y
    assert -4.25 <= pose[:, 1].min() < -4 and 4 < pose[:, 1].max() <= 4.25
    degrees = pose[:, 2] * 180 / torch.pi
    assert -20 <= degrees.min() < -18 and 18 < degrees.max() <= 20


@pytest.mark.parametrize(
    ("option", "value"), [("offset", 1.5), ("offset", -0.1), ("heading_jitter", 200.0), ("offset", float("nan"))]
)
def test_a_start_that_cannot_be_is_refused(option, value):
    with pytest.raises(ConfigError, match=rf"start\.{option} is {value}; it must be "):
        Start(**{option: value})


# Sensors that err


def test_noise_spreads_the_readings_about_the_truth_and_follows_the_seed():
    def readings(seed: int, noise: float) -> torch.Tensor:
        env = TrackEnv("oval", num_envs=4000, seed=seed, sensor=Sensor(max_range=30.0, noise=noise))
        return env.reset()["observation"]

    truth, noisy = readings(0, 0.0), readings(0, 0.6)
    inside = (truth > 0.1) & (truth < 0.9)
    errors = ((noisy - truth) * 30.0)[inside]
    assert errors.mean().abs() < 0.02
    assert errors.std() == pytest.approx(0.6, abs=0.02)
    assert torch.equal(noisy, readings(0, 0.6))
    assert not torch.equal(noisy, readings(1, 0.6))
    assert noisy.min() >= 0 and noisy.max() <= 1


def test_a_ray_that_drops_out_reads_the_full_range():
    env = TrackEnv("oval", num_envs=4000, seed=0, sensor=Sensor(max_range=30.0, dropout=0.25))
    truth = TrackEnv("oval", num_envs=1, sensor=Sensor(max_range=30.0)).reset()["observation"]
    readings = env.reset()["observation"]
    lost = readings[:, 0] == 1
    assert lost.float().mean() == pytest.approx(0.25, abs=0.03)
    torch.testing.assert_close(readings[~lost][:, 0], truth[0, 0].expand(int((~lost).sum())))


def test_the_reward_counts_true_distances_whatever_the_sensor_reads():
    blind, seeing = (TrackEnv("oval", seed=0, sensor=Sensor(dropout=dropout)) for dropout in (1.0, 0.0))
    plan = [1] * 8
    for one, other in zip(drive(blind, plan), drive(seeing, plan), strict=True):
        assert (one["observation"] == 1).all()
        assert torch.equal(one["reward_terms"], other["reward_terms"])


def test_agents_with_noisy_sensors_fare_as_they_would_alone():
    options = {
        "num_envs": 2,
        "start": Start(anywhere=True, heading_jitter=5.0),
        "sensor": Sensor(noise=0.3, dropout=0.1),
    }
    together = TrackEnv(seed=[5, 6], **options).rollout(150, break_when_any_done=False)
    for index, seed in enumerate((5, 6)):
        alone = TrackEnv(seed=seed, **options).rollout(150, break_when_any_done=False)
        assert (together[2 * index : 2 * index + 2] == alone).all()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
@pytest.mark.parametrize("track", ["paper", ["oval", "serpentine"]])
def test_a_cuda_device_gives_the_same_rollouts_as_the_cpu(track):
    rollouts = []
    for device in ("cpu", "cuda"):
        env = TrackEnv(track, num_envs=64, device=device, seed=0, start=Start(anywhere=True))
        rollouts.append(env.rollout(50, break_when_any_done=False).cpu())
    on_cpu, on_cuda = rollouts
    together = (on_cpu["next", "done"] == on_cuda["next", "done"]).all()
    assert together
    for key in ("observation", "pose", ("next", "reward")):
        torch.testing.assert_close(on_cpu[key], on_cuda[key], atol=1e-3, rtol=0)


def test_shaping_counts_the_way_to_the_next_gates_middle_and_is_part_of_the_sum():
    env = TrackEnv(
        "oval",
        num_envs=4,
        seed=0,
        start=Start(anywhere=True),
        reward=Reward({**paper_reward().terms, "shaping": Shaping(0.5, 0.9)}),
    )
    check_env_specs(env)
    rollout = env.rollout(60, break_when_any_done=False)["next"]
    assert rollout["reward_terms"].shape == (4, 60, 5)
    torch.testing.assert_close(rollout["reward"], rollout["reward_terms"].sum(-1, keepdim=True))
    start = env.reset()
    middle = env.track.gates.mean(dim=1)[start["next_gate"]]
    before = (start["pose"][:, :2] - middle).norm(dim=-1)
    after = env.step(start.set("action", torch.zeros(4, dtype=torch.int64)))["next"]
    expected = 0.5 * (
        before - 0.9 * (after["pose"][:, :2] - env.track.gates.mean(dim=1)[after["next_gate"]]).norm(dim=-1)
    )
    torch.testing.assert_close(after["reward_terms"][:, 4], expected, atol=1e-4, rtol=1e-4)


# What is refused, and what is handed to another process


def step_with(env, **changes):
    """One step from the start with these entries in place of the state's own."""
    return env.step(env.reset().update({"action": torch.zeros(env.batch_size, dtype=torch.int64)} | changes))["next"]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (torch.tensor([1.9, 0.0]), r"action is of torch\.float32; it must be of torch\.int64"),
        (torch.tensor([True, False]), r"action is of torch\.bool; it must be of torch\.int64"),
        (torch.tensor([[0], [1]]), r"action has the shape \[2, 1\]; it must have \[2\]"),
        (torch.tensor([[0, 1, 0], [1, 0, 0]]), r"action has the shape \[2, 3\]; it must have \[2\]"),
        (torch.tensor([0, 3]), "action of car 1 is 3; it must be 0 forward, 1 left or 2 right"),
        (torch.tensor([-1, 0]), "action of car 0 is -1; it must be 0 forward, 1 left or 2 right"),
    ],
)
def test_an_action_of_another_type_shape_or_range_is_refused(action, message):
    with pytest.raises(ConfigError, match=message):
        step_with(TrackEnv(num_envs=2), action=action)


def test_integers_of_every_type_are_actions():
    plain = step_with(TrackEnv(num_envs=3), action=torch.tensor([0, 1, 2]))
    for dtype in (torch.int32, torch.int16, torch.int8, torch.uint8):
        after = step_with(TrackEnv(num_envs=3), action=torch.tensor([0, 1, 2], dtype=dtype))
        assert (after == plain).all()
        assert after["last_action"].dtype is torch.int64


def test_a_gate_that_the_track_does_not_have_is_refused():
    with pytest.raises(ConfigError, match=r"a gate's index is not one of those .* reset the cars"):
        step_with(TrackEnv(num_envs=2), next_gate=torch.tensor([0, 99]))


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("column", range(3))
@pytest.mark.parametrize("compiled", [True, False])
def test_a_car_whose_pose_is_not_finite_terminates_and_the_others_drive(value, column, compiled, monkeypatch):
    monkeypatch.setattr("carrl.task.task.Simulator", partial(Simulator, compiled=compiled))
    env = TrackEnv(num_envs=2, reward=Reward({**paper_reward().terms, "shaping": Shaping(0.5)}))
    pose = env.reset()["pose"]
    pose[0, column] = value
    after = step_with(env, pose=pose)
    assert after["terminated"].tolist() == [[True], [False]]
    assert after["reward_terms"][0, :4].tolist() == [-200, 0, 0, 0]
    assert after["reward"].isfinite().all()
    assert after["observation"].isfinite().all()


WRONG_TYPES = [
    {"num_envs": "4"},
    {"num_envs": 2.0},
    {"num_envs": True},
    {"num_envs": 2**21},
    {"max_steps": 1.5},
    {"max_steps": True},
    {"seed": "1"},
    {"seed": 1.5},
    {"seed": True},
    {"seed": -1},
    {"seed": 2**63},
    {"start": "anywhere"},
    {"observation": 2},
    {"vehicle": 3},
    {"sensor": "wide"},
    {"reward": {"gate": 50}},
    {"track": 3},
    {"track": None},
]


@pytest.mark.parametrize("wrong", WRONG_TYPES, ids=str)
def test_a_parameter_of_another_type_or_range_is_refused_in_one_sentence(wrong):
    ((name, _),) = wrong.items()
    with pytest.raises(ConfigError, match=rf"^(env\.)?{name} is [^;]*; it must be [^\n]*$"):
        TrackEnv(**wrong)


WRONG_STARTS = [
    {"offset": "0.5"},
    {"heading_jitter": True},
    {"anywhere": "no"},
    {"sample_track": 1},
    {"mirrored": None},
    {"reversed": "yes"},
]


@pytest.mark.parametrize("wrong", WRONG_STARTS, ids=str)
def test_a_start_of_another_type_is_refused_in_one_sentence(wrong):
    ((name, _),) = wrong.items()
    with pytest.raises(ConfigError, match=rf"^start\.{name} is [^;]*; it must be [^\n]*$"):
        Start(**wrong)


def test_each_seed_of_a_list_is_checked():
    with pytest.raises(ConfigError, match=r"seed\[1\] is 'a'; it must be a whole number"):
        TrackEnv(seed=[1, "a"])


@pytest.mark.parametrize("seed", [1.5, True, "1", -1, 2**63])
def test_a_seed_that_is_set_is_checked(seed):
    with pytest.raises(ConfigError, match=r"^seed is .*; it must be a whole number, at least 0"):
        TrackEnv().set_seed(seed)


def test_numpys_integers_are_sizes_and_seeds():
    env = TrackEnv(num_envs=np.int64(2), seed=np.int32(3), max_steps=np.int64(9), start=Start(anywhere=True))
    first = env.reset()["pose"]
    assert torch.equal(first, TrackEnv(num_envs=2, seed=3, start=Start(anywhere=True)).reset()["pose"])
    env.set_seed(np.int64(3))
    assert torch.equal(first, env.reset()["pose"])


def test_a_track_may_be_given_as_a_path(tmp_path):
    with pytest.raises(TrackError, match="no file of this path"):
        TrackEnv(track=tmp_path / "nowhere.csv")


def test_a_pickled_environment_goes_on_where_it_stood():
    env = TrackEnv("oval", num_envs=2, seed=[5, 6], start=Start(anywhere=True))
    env.reset()
    copy = pickle.loads(pickle.dumps(env))
    drawn, again = (each.rollout(30, break_when_any_done=False) for each in (env, copy))
    assert (drawn == again).all()
    assert (drawn["pose"][:, 0] != env.reset()["pose"]).any()


def test_an_environment_can_be_handed_to_a_spawned_process():
    env = TrackEnv("oval", num_envs=2, seed=1, start=Start(anywhere=True))
    worker = multiprocessing.get_context("spawn").Process(target=TrackEnv.rollout, args=(env, 3))
    worker.start()
    worker.join()
    assert worker.exitcode == 0


def test_an_environment_and_a_track_tell_of_themselves_in_one_line():
    track = Track.load("oval")
    assert repr(track) == f"Track('oval', {track.length:.1f} m, {track.gate_count} gates)"
    assert repr(TrackEnv(track, num_envs=3)) == "TrackEnv('oval', cars=3, rays=7, max_steps=1000, device='cpu')"
    assert repr(TrackEnv(["oval", "paper"])).startswith("TrackEnv(['oval', 'paper'], cars=1, rays=7, ")


def test_what_it_takes_is_shown_though_torchrl_hides_it():
    class Longer(TrackEnv):
        def __init__(self, track="oval", laps=2):
            super().__init__(track, max_steps=1000 * laps)

    assert list(inspect.signature(TrackEnv).parameters)[:4] == ["track", "num_envs", "device", "seed"]
    assert list(inspect.signature(Longer).parameters) == ["track", "laps"]
