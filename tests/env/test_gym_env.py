"""The driving task as Gymnasium sees it."""

import inspect

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import carrl
from carrl import Reward, Start, paper_reward, rays_and_last_action
from carrl.errors import ConfigError
from carrl.task.reward import Shaping
from carrl.task.task import make_task

PAPER_TERMS = paper_reward().term_names


@pytest.fixture
def _no_display(monkeypatch):
    """Windows open on nothing."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.mark.usefixtures("_no_display")
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"render_mode": "rgb_array"},
        {"render_mode": "human"},
        {"start": Start(anywhere=True)},
        {"observation": rays_and_last_action()},
    ],
)
def test_gymnasiums_checker_passes(options):
    pytest.importorskip("pygame", reason="the checker draws in every mode; pip install 'carrl[render]'")
    env = gymnasium.make("carrl/Track-v0", track="oval", **options)
    check_env(env.unwrapped)
    env.close()


def test_it_is_the_same_task_as_the_torchrl_environment():
    gym_env, env = gymnasium.make("carrl/Track-v0", track="paper"), carrl.TrackEnv(track="paper")
    observation, info = gym_env.reset(seed=0)
    state = env.reset()
    actions = np.random.default_rng(0).choice(3, size=200, p=[0.6, 0.3, 0.1])
    for action in actions:
        np.testing.assert_array_equal(observation, state["observation"][0].numpy())
        np.testing.assert_array_equal(info["pose"], state["pose"][0].numpy())
        observation, reward, terminated, truncated, info = gym_env.step(action)
        transition, state = env.step_and_maybe_reset(state.set("action", torch.tensor([action])))
        after = transition["next"]
        assert (reward, terminated, truncated) == (after["reward"].item(), after["terminated"].item(), False)
        assert [info[name] for name in ("collision", "proximity", "gate", "steering")] == after["reward_terms"][
            0
        ].tolist()
        if terminated:
            observation, info = gym_env.reset()


def test_an_episode_is_truncated_at_a_thousand_steps_or_as_asked():
    assert gymnasium.make("carrl/Track-v0").spec.max_episode_steps == 1000
    env = gymnasium.make("carrl/Track-v0", max_episode_steps=3)
    env.reset(seed=0)
    assert [env.step(0)[3] for _ in range(3)] == [False, False, True]


def test_random_starts_follow_the_seed():
    env = gymnasium.make("carrl/Track-v0", start=Start(anywhere=True))
    first, again, other = (env.reset(seed=seed)[1]["pose"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_what_was_handed_out_neither_changes_later_nor_changes_what_follows():
    env, twin = (gymnasium.make("carrl/Track-v0").unwrapped for _ in range(2))
    view, info = env.reset()
    twin.reset()
    kept = view.copy(), info["pose"].copy()
    env.step(1)
    twin.step(1)
    np.testing.assert_array_equal(view, kept[0])
    np.testing.assert_array_equal(info["pose"], kept[1])
    view[:], info["pose"][:] = 0, 0
    np.testing.assert_array_equal(env.step(0)[0], twin.step(0)[0])
    np.testing.assert_array_equal(env.reset()[0], kept[0])


def test_stepping_before_a_reset_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded):
        gymnasium.make("carrl/Track-v0").unwrapped.step(0)


def test_an_action_that_does_not_exist_is_refused():
    env = gymnasium.make("carrl/Track-v0").unwrapped
    env.reset()
    for action in (-1, 3):
        with pytest.raises(gymnasium.error.InvalidAction, match="0 forward, 1 left or 2 right"):
            env.step(action)


def test_a_misspelt_option_is_answered_with_all_that_there_are():
    with pytest.raises(ConfigError, match="unexpected keyword argument 'random_strat'") as refusal:
        gymnasium.make("carrl/Track-v0", random_strat=True)
    names = {"track", "render_mode", "max_episode_steps", *inspect.signature(make_task).parameters}
    names -= {"max_steps", "num_envs", "seeds", "device"}
    assert set(str(refusal.value).split("(choose from ")[1].split(")")[0].split(", ")) == names


def test_max_steps_is_refused_in_favour_of_gymnasiums_own_name():
    with pytest.raises(ConfigError, match=r"argument 'max_steps' .*max_episode_steps"):
        gymnasium.make("carrl/Track-v0", max_steps=5)


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ConfigError, match="render_mode is 'ansi'; choose one of human, rgb_array"):
        carrl.GymTrackEnv(render_mode="ansi")


def test_rendering_without_a_render_mode_is_refused():
    env = carrl.GymTrackEnv()
    env.reset()
    with pytest.raises(ConfigError, match="there is no render_mode"):
        env.render()


def test_a_car_that_has_crashed_is_not_driven_on():
    env = gymnasium.make("carrl/Track-v0")
    env.reset()
    reward, terminated = 0.0, False
    while not terminated:
        _, reward, terminated, *_ = env.step(1)
    assert reward == -200
    for _ in range(2):
        with pytest.raises(gymnasium.error.ResetNeeded, match="hit a wall, which ended its episode; reset it"):
            env.step(0)
    env.reset()
    assert env.step(0)[1:3] == (0, False)


def test_a_car_that_was_truncated_may_drive_on_as_in_gymnasiums_own_environments():
    env, free = gymnasium.make("carrl/Track-v0", max_episode_steps=2), gymnasium.make("carrl/Track-v0")
    own = gymnasium.make("CartPole-v1", max_episode_steps=2)
    for each in (env, free, own):
        each.reset(seed=0)
    for step in range(4):
        view, reward, terminated, truncated, _ = env.step(0)
        assert (reward, terminated) == free.step(0)[1:3]
        assert truncated == own.step(step % 2)[3] == (step >= 1)
        assert view in env.observation_space


@pytest.mark.parametrize(
    "action",
    [
        *(1.9, 1.0, np.float32(1), np.nan, torch.tensor(1.0)),
        *(True, np.True_, np.array(True), torch.tensor(True)),
        *([1], np.array([1]), torch.tensor([1])),
        *("1", None, 3, -1, 2**70),
    ],
    ids=repr,
)
def test_an_action_is_one_of_three_whole_numbers_and_nothing_else(action):
    env = gymnasium.make("carrl/Track-v0").unwrapped
    env.reset()
    with pytest.raises(ConfigError, match=r"^action is .*; it must be the whole number 0 forward, 1 left or 2 right$"):
        env.step(action)
    assert env.snapshot().step == 0


@pytest.mark.parametrize("left", [1, np.int64(1), np.uint8(1), np.array(1), torch.tensor(1)], ids=repr)
def test_any_whole_number_of_one_is_left(left):
    env, twin = (gymnasium.make("carrl/Track-v0") for _ in range(2))
    env.reset()
    twin.reset()
    np.testing.assert_array_equal(env.step(left)[4]["pose"], twin.step(1)[4]["pose"])


WRONG_SEEDS = [1.5, True, "1", -1, 2**63]


@pytest.mark.parametrize("seed", WRONG_SEEDS)
def test_a_seed_is_a_whole_number_that_the_generators_take(seed):
    env = gymnasium.make("carrl/Track-v0", start=Start(anywhere=True))
    with pytest.raises(ConfigError, match=r"^seed is .*; it must be a whole number, at least 0 and at most 92233"):
        env.reset(seed=seed)


def test_numpys_integers_are_seeds():
    env = gymnasium.make("carrl/Track-v0", start=Start(anywhere=True))
    plain, numpys = env.reset(seed=7)[1]["pose"], env.reset(seed=np.int64(7))[1]["pose"]
    np.testing.assert_array_equal(plain, numpys)


def test_infos_hold_the_same_numbers_after_a_reset_and_after_a_step():
    env = gymnasium.make(
        "carrl/Track-v0", track=["oval", "paper"], reward=Reward({**paper_reward().terms, "shaping": Shaping(0.1)})
    )
    assert [track.name for track in env.unwrapped.tracks] == ["oval", "paper"]
    _, first = env.reset()
    *_, after = env.step(0)
    assert list(first) == list(after) == ["pose", "gates_passed", "track", *PAPER_TERMS, "shaping"]
    assert [first[name] for name in (*PAPER_TERMS, "shaping")] == [0] * 5
    for name, value in (first | after).items():
        assert np.asarray(value).dtype.kind in "if", name


def test_a_reset_may_put_the_car_anywhere_along_the_track():
    env = gymnasium.make("carrl/Track-v0", track="oval")
    track = env.unwrapped.tracks[0]
    for options, station in (({"station": 30.0}, 30.0), (None, 0.0)):
        _, info = env.reset(options=options)
        np.testing.assert_allclose(info["pose"], track.pose_at(torch.tensor([station]))[0], atol=1e-5)
    for station in (-1, 1e6, "far", np.nan):
        with pytest.raises(ConfigError, match=r"station is .*; it must be a place on the track, from 0 to "):
            env.reset(options={"station": station})
